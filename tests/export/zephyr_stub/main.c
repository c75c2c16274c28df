/* Steps the driver through rows of current, voltage, temperature, one each argv[2] milliseconds, and prints every
 * property after each. argv[1]: "keep" keeps the state in a file at the end, "late" loads settings after the first row. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zephyr/drivers/fuel_gauge.h>
#include <zephyr/drivers/sensor.h>
#include <zephyr/kernel.h>
#include <zephyr/settings/settings.h>

#include "cellwise_fuel_gauge.h"

static struct k_work_delayable *waiting;
static float row[3];
static uint32_t uptime_ms;

uint32_t k_uptime_get_32(void) { return uptime_ms; }

int k_work_schedule(struct k_work_delayable *work, int ms)
{
    waiting = ms > 0 ? work : waiting;
    return 0;
}

int sensor_sample_fetch(const struct device *dev) { return dev != NULL; }

int sensor_channel_get(const struct device *dev, enum sensor_channel channel, struct sensor_value *value)
{
    const double seen = channel == SENSOR_CHAN_CURRENT ? -row[0] : row[(int)channel];
    (void)dev;
    if (seen != seen) return -EIO;
    value->val1 = (int32_t)seen;
    value->val2 = (int32_t)(1e6 * (seen - value->val1));
    return 0;
}

int settings_save_one(const char *name, const void *value, size_t size)
{
    FILE *file = fopen(strrchr(name, '/') + 1, "wb");
    const int wrong = fwrite(value, 1, size, file) != size;
    return fclose(file) + wrong;
}

static ssize_t read_file(void *file, void *data, size_t size) { return (ssize_t)fread(data, 1, size, file); }

static void load_settings(void)
{
    const char *keys[] = {"0", "1"};
    int k;
    for (k = 0; k < 2; k++) {
        FILE *file = fopen(keys[k], "rb");
        if (file == NULL) continue;
        fseek(file, 0, SEEK_END);
        const long size = ftell(file);
        rewind(file);
        if (stub_set(keys[k], (size_t)size, read_file, file) != 0) fprintf(stderr, "refused %s\n", keys[k]);
        fclose(file);
    }
    stub_commit();
}

int main(int count, char **argument)
{
    const struct fuel_gauge_driver_api *api = stub_device.api;
    int which;
    if (stub_device.init(&stub_device) != 0 || count != 3) return 1;
    if (strcmp(argument[1], "late") != 0) load_settings();
    {
        union fuel_gauge_prop_val early;
        if (api->get_property(&stub_device, FUEL_GAUGE_VOLTAGE, &early) != -EAGAIN) return 2;
    }
    while (scanf("%f %f %f", &row[0], &row[1], &row[2]) == 3) {
        uptime_ms += (uint32_t)atoi(argument[2]);
        if (STUB_HAS_SENSOR) waiting->handler(NULL);
        else if (cellwise_fuel_gauge_sample(&stub_device, row[0], row[1], row[2]) != 0) return 3;
        for (which = FUEL_GAUGE_AVG_CURRENT; which <= FUEL_GAUGE_VOLTAGE; which++) {
            union fuel_gauge_prop_val value = {0};
            const int wrong = api->get_property(&stub_device, (fuel_gauge_prop_t)which, &value);
            printf("%d ", which == FUEL_GAUGE_CYCLE_COUNT ? wrong + ENOTSUP : wrong ? -9 : value.current);
        }
        printf("\n");
        if (strcmp(argument[1], "late") == 0) load_settings(); /* again after each: the first one counts */
    }
    return strcmp(argument[1], "keep") == 0 ? cellwise_fuel_gauge_keep(&stub_device) : 0;
}
