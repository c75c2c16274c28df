/* Zephyr's fuel_gauge API on cellwise_ekf.c, written after its documentation; not built in a Zephyr tree by those who
 * wrote it. One instance: the state is kept under one name. */
#define DT_DRV_COMPAT cellwise_fuel_gauge

#include "cellwise_fuel_gauge.h"

#include "cellwise_cell.h"
#include "cellwise_store.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <zephyr/drivers/fuel_gauge.h>
#include <zephyr/kernel.h>
#include <zephyr/settings/settings.h>

#define STEP_S (CELLWISE_DT_S)
#define START_SOC 0.5f       /* nobody says where it begins */
#define START_VARIANCE 0.09f
#define MEAN_S 60.0f         /* of the current that a runtime is of */
#define NO_RUNTIME 65535u    /* it is not discharged, or not charged */
#define COMPONENTS 11u

struct gauge_data {
    struct k_mutex lock;
#if CELLWISE_BANK
    cellwise_bank bank;
    cellwise_state state[COMPONENTS + 1u]; /* the estimate first */
#else
    cellwise_state state[1];
#endif
    cellwise_stored slots[2];
    cellwise_input last;
    cellwise_output out;
    float mean_A;
    uint32_t status;
    bool begun, damaged;
};

static struct gauge_data gauge;

static float capacity_Ah(void)
{
    return STEP_S / (3600.0f * cellwise_cell.constant.soc_per_A);
}

int cellwise_fuel_gauge_sample(const struct device *dev, float current_A, float voltage_V, float temperature_C)
{
    struct gauge_data *own = dev->data;
    if (own->damaged) return -EIO;
    k_mutex_lock(&own->lock, K_FOREVER);
    own->last.current_A = current_A;
    own->last.voltage_V = voltage_V;
    own->last.temperature_C = temperature_C;
#if CELLWISE_BANK
    own->status = cellwise_bank_step(&cellwise_cell, &own->bank, own->state, COMPONENTS, &own->last, &own->out);
#else
    own->status = cellwise_step(&cellwise_cell, own->state, &own->last, &own->out);
#endif
    own->last.sequence++;
    own->mean_A = own->begun ? own->mean_A + (current_A - own->mean_A) * STEP_S / (STEP_S + MEAN_S) : current_A;
    own->begun = true;
    k_mutex_unlock(&own->lock);
    return 0;
}

static uint32_t minutes(float charge_Ah, float current_A)
{
    const float found = 60.0f * charge_Ah / current_A;
    return current_A > 0.0f && found < (float)NO_RUNTIME ? (uint32_t)found : NO_RUNTIME;
}

static int property(struct gauge_data *own, fuel_gauge_prop_t which, union fuel_gauge_prop_val *value)
{
    const float soc = fminf(fmaxf(own->out.soc, 0.0f), 1.0f), all_Ah = capacity_Ah();
    switch (which) {
    case FUEL_GAUGE_RELATIVE_STATE_OF_CHARGE:
        value->relative_state_of_charge = (uint8_t)(100.0f * soc + 0.5f);
        return 0;
    case FUEL_GAUGE_REMAINING_CAPACITY:
        value->remaining_capacity = (uint32_t)(1e6f * soc * all_Ah);
        return 0;
    case FUEL_GAUGE_FULL_CHARGE_CAPACITY:
        value->full_charge_capacity = (uint32_t)(1e6f * all_Ah);
        return 0;
    case FUEL_GAUGE_RUNTIME_TO_EMPTY:
        value->runtime_to_empty = minutes(soc * all_Ah, own->mean_A);
        return 0;
    case FUEL_GAUGE_RUNTIME_TO_FULL:
        value->runtime_to_full = minutes((1.0f - soc) * all_Ah, -own->mean_A);
        return 0;
    case FUEL_GAUGE_CURRENT: /* uA, negative on discharge */
        value->current = (int)(-1e6f * own->last.current_A);
        return 0;
    case FUEL_GAUGE_AVG_CURRENT:
        value->avg_current = (int)(-1e6f * own->mean_A);
        return 0;
    case FUEL_GAUGE_VOLTAGE: /* uV */
        value->voltage = (int)(1e6f * own->last.voltage_V);
        return 0;
    case FUEL_GAUGE_TEMPERATURE: /* 0.1 K */
        value->temperature = (uint16_t)(10.0f * (own->last.temperature_C + 273.15f) + 0.5f);
        return 0;
    case FUEL_GAUGE_FLAGS:
        value->flags = own->status | (own->damaged ? CELLWISE_FUEL_GAUGE_DAMAGED : 0u);
        return 0;
    default:
        return -ENOTSUP;
    }
}

static int get_property(const struct device *dev, fuel_gauge_prop_t which, union fuel_gauge_prop_val *value)
{
    struct gauge_data *own = dev->data;
    int found;
    if (which != FUEL_GAUGE_FLAGS && own->damaged) return -EIO;
    if (which != FUEL_GAUGE_FLAGS && which != FUEL_GAUGE_FULL_CHARGE_CAPACITY && !own->begun) return -EAGAIN;
    k_mutex_lock(&own->lock, K_FOREVER);
    found = property(own, which, value);
    k_mutex_unlock(&own->lock);
    return found;
}

int cellwise_fuel_gauge_keep(const struct device *dev)
{
    struct gauge_data *own = dev->data;
    uint32_t newest, to;
    k_mutex_lock(&own->lock, K_FOREVER);
    newest = cellwise_newest_slot(&own->slots[0], &own->slots[1]);
    to = 1u - newest;
    cellwise_keep(&own->slots[to], own->state, &own->slots[newest]);
    k_mutex_unlock(&own->lock);
    return settings_save_one(to == 0u ? "@NAME@/0" : "@NAME@/1", &own->slots[to], sizeof(cellwise_stored));
}

static int kept_was_read(const char *key, size_t size, settings_read_cb read, void *argument)
{
    const int which = key[0] - '0';
    if ((which != 0 && which != 1) || key[1] != '\0' || size != sizeof(cellwise_stored)) return -ENOENT;
    return read(argument, &gauge.slots[which], size) == (ssize_t)size ? 0 : -EIO;
}

static int go_on(void)
{
    const cellwise_stored *newest;
    if (gauge.begun || gauge.damaged) return 0;
    newest = &gauge.slots[cellwise_newest_slot(&gauge.slots[0], &gauge.slots[1])];
#if CELLWISE_BANK
    (void)cellwise_bank_restore(&cellwise_cell, &gauge.bank, gauge.state, COMPONENTS, newest, CELLWISE_AGE_UNKNOWN);
#else
    (void)cellwise_restore(&cellwise_cell, gauge.state, newest, CELLWISE_AGE_UNKNOWN);
#endif
    return 0;
}

SETTINGS_STATIC_HANDLER_DEFINE(@NAME@, "@NAME@", NULL, kept_was_read, go_on, NULL);

#if DT_INST_NODE_HAS_PROP(0, sensor)
#include <zephyr/drivers/sensor.h>

static void measure(struct k_work *work);
static K_WORK_DELAYABLE_DEFINE(measuring, measure);

static float value_of(const struct device *sensor, enum sensor_channel channel)
{
    struct sensor_value value;
    return sensor_channel_get(sensor, channel, &value) == 0 ? sensor_value_to_float(&value) : NAN;
}

/* A channel that is not there is a sample that is missing, which the step knows how to take. */
static void measure(struct k_work *work)
{
    const struct device *sensor = DEVICE_DT_GET(DT_INST_PHANDLE(0, sensor));
    const float sign = DT_INST_PROP(0, charge_positive) ? -1.0f : 1.0f;
    const bool fetched = sensor_sample_fetch(sensor) == 0;
    const float current_A = fetched ? sign * value_of(sensor, SENSOR_CHAN_CURRENT) : NAN;
    const float voltage_V = fetched ? value_of(sensor, SENSOR_CHAN_VOLTAGE) : NAN;
    const float temperature_C = fetched ? value_of(sensor, SENSOR_CHAN_DIE_TEMP) : NAN;
    (void)work;
    (void)k_work_schedule(&measuring, K_MSEC(@DT_MS@));
    (void)cellwise_fuel_gauge_sample(DEVICE_DT_INST_GET(0), current_A, voltage_V, temperature_C);
}
#endif

static int begin(const struct device *dev)
{
    struct gauge_data *own = dev->data;
    (void)k_mutex_init(&own->lock);
    own->damaged = cellwise_check_model(&cellwise_cell) != 0u;
#if CELLWISE_BANK
    (void)cellwise_bank_init(&cellwise_cell, &own->bank, own->state, COMPONENTS, START_SOC, START_VARIANCE);
#else
    (void)cellwise_init(&cellwise_cell, own->state, START_SOC, START_VARIANCE);
#endif
#if DT_INST_NODE_HAS_PROP(0, sensor)
    (void)k_work_schedule(&measuring, K_MSEC(@DT_MS@));
#endif
    return 0;
}

static DEVICE_API(fuel_gauge, gauge_api) = {.get_property = get_property};

DEVICE_DT_INST_DEFINE(0, begin, NULL, &gauge, NULL, POST_KERNEL, CONFIG_FUEL_GAUGE_INIT_PRIORITY, &gauge_api);
