#ifndef STUB_SENSOR_H
#define STUB_SENSOR_H

#include <zephyr/device.h>

enum sensor_channel { SENSOR_CHAN_CURRENT, SENSOR_CHAN_VOLTAGE, SENSOR_CHAN_DIE_TEMP };
struct sensor_value {
    int32_t val1, val2;
};

int sensor_sample_fetch(const struct device *dev);
int sensor_channel_get(const struct device *dev, enum sensor_channel channel, struct sensor_value *value);
static inline float sensor_value_to_float(const struct sensor_value *v)
{
    return (float)v->val1 + 1e-6f * (float)v->val2;
}

#endif
