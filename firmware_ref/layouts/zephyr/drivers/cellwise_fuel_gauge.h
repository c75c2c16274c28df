/* The estimator as a device of Zephyr's fuel_gauge API. */
#ifndef CELLWISE_FUEL_GAUGE_H
#define CELLWISE_FUEL_GAUGE_H

#include <zephyr/device.h>

/* Bits of FUEL_GAUGE_FLAGS are those of the step (cellwise_ekf.h), and this one: the tables are damaged, no step is
 * taken. */
#define CELLWISE_FUEL_GAUGE_DAMAGED 0x80000000u

/* Take one sample, at least once in each time step of the tables, as often as you like: the uptime says when a step is
 * due. `current_A` flowed since the last one, positive on discharge; NAN for what was not measured. Returns 0, or -EIO
 * where the tables are damaged. */
int cellwise_fuel_gauge_sample(const struct device *dev, float current_A, float voltage_V, float temperature_C);

/* Keep the state in settings: before the power goes, and now and then (a node with a sensor does, every
 * CONFIG_@UPPER@_FUEL_GAUGE_KEEP_MINUTES). Two records take turns, so that one is whole when the power is lost in the
 * middle of a write. The first `settings_load()` brings it back. */
int cellwise_fuel_gauge_keep(const struct device *dev);

#endif
