/* The names of Zephyr's documentation that the driver uses, for a build on this machine. */
#ifndef STUB_DEVICE_H
#define STUB_DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

struct device {
    int (*init)(const struct device *dev);
    void *data;
    const void *api;
};

extern const struct device stub_device;

#define DEVICE_API(kind, name) const struct kind##_driver_api name
#define DEVICE_DT_INST_GET(n) (&stub_device)
#define DEVICE_DT_INST_DEFINE(n, init, pm, data, config, level, priority, api) \
    const struct device stub_device = {init, data, api}
#define DT_INST_NODE_HAS_PROP(n, property) STUB_HAS_SENSOR
#define DT_INST_PROP(n, property) 1
#define DT_INST_PHANDLE(n, property) n
#define DEVICE_DT_GET(node) ((const struct device *)0)
#define CONFIG_FUEL_GAUGE_INIT_PRIORITY 90

#endif
