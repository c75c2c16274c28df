/* Zephyr's fuel_gauge API on cellwise_ekf.c, written after its documentation; not built in a Zephyr tree by those who
 * wrote it. One instance: the state is kept under one name. */
#define DT_DRV_COMPAT cellwise_fuel_gauge

#include "cellwise_fuel_gauge.h"

#include "cellwise_glue.h"

#include <errno.h>
#include <stdlib.h>
#include <zephyr/drivers/fuel_gauge.h>
#include <zephyr/kernel.h>
#include <zephyr/settings/settings.h>

#define STEP_MS @DT_MS@u
#define MEAN_S 60.0f         /* of the current that a runtime is of */
#define NO_RUNTIME 65535u    /* it is not discharged, or not charged */

struct gauge_data {
    struct k_mutex lock;
    cellwise_glue glue;
    float current_A, voltage_V, temperature_C; /* last ones, NAN where there was none */
    float mean_A;
    bool was_read, is_loaded; /* what settings kept */
};

static struct gauge_data gauge = {.mean_A = NAN};

static float capacity_Ah(void)
{
    return CELLWISE_DT_S / (3600.0f * cellwise_cell.constant.soc_per_A);
}

int cellwise_fuel_gauge_sample(const struct device *dev, float current_A, float voltage_V, float temperature_C)
{
    struct gauge_data *own = dev->data;
    if (own->glue.faults != 0u) return -EIO;
    k_mutex_lock(&own->lock, K_FOREVER);
    own->current_A = current_A;
    own->voltage_V = voltage_V;
    own->temperature_C = temperature_C;
    if (cellwise_glue_sample(&own->glue, k_uptime_get_32(), current_A, voltage_V, temperature_C) && isfinite(current_A)) {
        const float share = CELLWISE_DT_S / (CELLWISE_DT_S + MEAN_S);
        own->mean_A = isnan(own->mean_A) ? current_A : own->mean_A + share * (current_A - own->mean_A);
    }
    k_mutex_unlock(&own->lock);
    return 0;
}

static uint32_t minutes(float charge_Ah, float current_A)
{
    const float found = 60.0f * charge_Ah / current_A;
    return current_A > 0.0f && found < (float)NO_RUNTIME ? (uint32_t)found : NO_RUNTIME;
}

/* A reading in millionths; a conversion of NAN is undefined in C. */
static int micro(float reading, int *to)
{
    if (!isfinite(reading)) return -ENODATA;
    *to = (int)(1e6f * reading);
    return 0;
}

static int property(struct gauge_data *own, fuel_gauge_prop_t which, union fuel_gauge_prop_val *value)
{
    const float soc = fminf(fmaxf(own->glue.soc, 0.0f), 1.0f), all_Ah = capacity_Ah();
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
        return micro(-own->current_A, &value->current);
    case FUEL_GAUGE_AVG_CURRENT:
        return micro(-own->mean_A, &value->avg_current);
    case FUEL_GAUGE_VOLTAGE: /* uV */
        return micro(own->voltage_V, &value->voltage);
    case FUEL_GAUGE_TEMPERATURE: /* 0.1 K */
        if (!(own->temperature_C > -273.0f && own->temperature_C < 1000.0f)) return -ENODATA;
        value->temperature = (uint16_t)(10.0f * (own->temperature_C + 273.15f) + 0.5f);
        return 0;
    case FUEL_GAUGE_FLAGS:
        value->flags = own->glue.status | (own->glue.faults != 0u ? CELLWISE_FUEL_GAUGE_DAMAGED : 0u);
        return 0;
    default:
        return -ENOTSUP;
    }
}

static int get_property(const struct device *dev, fuel_gauge_prop_t which, union fuel_gauge_prop_val *value)
{
    struct gauge_data *own = dev->data;
    const bool is_known = which == FUEL_GAUGE_FLAGS || which == FUEL_GAUGE_FULL_CHARGE_CAPACITY;
    int found;
    if (which != FUEL_GAUGE_FLAGS && own->glue.faults != 0u) return -EIO;
    if (!is_known && !own->glue.is_begun) return -EAGAIN;
    k_mutex_lock(&own->lock, K_FOREVER);
    found = property(own, which, value);
    k_mutex_unlock(&own->lock);
    return found;
}

int cellwise_fuel_gauge_keep(const struct device *dev)
{
    struct gauge_data *own = dev->data;
    uint32_t to;
    k_mutex_lock(&own->lock, K_FOREVER);
    to = cellwise_glue_keep(&own->glue);
    k_mutex_unlock(&own->lock);
    return settings_save_one(to == 0u ? "@NAME@/0" : "@NAME@/1", &own->glue.slots[to], sizeof(cellwise_stored));
}

static int kept_was_read(const char *key, size_t size, settings_read_cb read, void *argument)
{
    const int which = key[0] - '0';
    if ((which != 0 && which != 1) || key[1] != '\0' || size != sizeof(cellwise_stored)) return -ENOENT;
    if (gauge.is_loaded) return 0;
    gauge.was_read = true;
    return read(argument, &gauge.glue.slots[which], size) == (ssize_t)size ? 0 : -EIO;
}

/* The first settings_load(), which may come after the first steps; a later one changes nothing. */
static int go_on(void)
{
    k_mutex_lock(&gauge.lock, K_FOREVER);
    if (gauge.was_read && !gauge.is_loaded) (void)cellwise_glue_begin(&gauge.glue, k_uptime_get_32(), STEP_MS);
    gauge.is_loaded = true;
    k_mutex_unlock(&gauge.lock);
    return 0;
}

SETTINGS_STATIC_HANDLER_DEFINE(@NAME@, "@NAME@", NULL, kept_was_read, go_on, NULL);

#if DT_INST_NODE_HAS_PROP(0, sensor)
#include <zephyr/drivers/sensor.h>

/* Of a load that changes the mean current counts; when a step is due the clock says, not how often this is called. */
#define POLL_MS (STEP_MS < 4u ? 1u : STEP_MS / 4u)
#define KEEP_MS (60000u * CONFIG_@UPPER@_FUEL_GAUGE_KEEP_MINUTES)

static uint32_t kept_ms;

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
    (void)k_work_schedule(&measuring, K_MSEC(POLL_MS));
    (void)cellwise_fuel_gauge_sample(DEVICE_DT_INST_GET(0), current_A, voltage_V, temperature_C);
    if (KEEP_MS > 0u && (k_uptime_get_32() - kept_ms >= KEEP_MS || cellwise_glue_has_moved(&gauge.glue))) {
        kept_ms = k_uptime_get_32();
        (void)cellwise_fuel_gauge_keep(DEVICE_DT_INST_GET(0));
    }
}
#endif

static int begin(const struct device *dev)
{
    struct gauge_data *own = dev->data;
    (void)k_mutex_init(&own->lock);
    (void)cellwise_glue_begin(&own->glue, k_uptime_get_32(), STEP_MS);
#if DT_INST_NODE_HAS_PROP(0, sensor)
    (void)k_work_schedule(&measuring, K_MSEC(POLL_MS));
#endif
    return 0;
}

static DEVICE_API(fuel_gauge, gauge_api) = {.get_property = get_property};

DEVICE_DT_INST_DEFINE(0, begin, NULL, &gauge, NULL, POST_KERNEL, CONFIG_FUEL_GAUGE_INIT_PRIORITY, &gauge_api);
