#ifndef STUB_FUEL_GAUGE_H
#define STUB_FUEL_GAUGE_H

#include <zephyr/device.h>

enum fuel_gauge_prop_type {
    FUEL_GAUGE_AVG_CURRENT, FUEL_GAUGE_CURRENT, FUEL_GAUGE_CYCLE_COUNT, FUEL_GAUGE_FLAGS,
    FUEL_GAUGE_FULL_CHARGE_CAPACITY, FUEL_GAUGE_REMAINING_CAPACITY, FUEL_GAUGE_RUNTIME_TO_EMPTY,
    FUEL_GAUGE_RUNTIME_TO_FULL, FUEL_GAUGE_RELATIVE_STATE_OF_CHARGE, FUEL_GAUGE_TEMPERATURE,
    FUEL_GAUGE_VOLTAGE
};
typedef uint16_t fuel_gauge_prop_t;

union fuel_gauge_prop_val {
    int avg_current, current, voltage;
    uint32_t cycle_count, flags, full_charge_capacity, remaining_capacity, runtime_to_empty, runtime_to_full;
    uint8_t relative_state_of_charge;
    uint16_t temperature;
};

struct fuel_gauge_driver_api {
    int (*get_property)(const struct device *dev, fuel_gauge_prop_t prop, union fuel_gauge_prop_val *val);
};

#endif
