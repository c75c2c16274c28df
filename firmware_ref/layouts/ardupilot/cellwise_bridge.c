/* A companion's side of ArduPilot: lines in, lines out, through cellwise_ekf.c.
 *
 *     cellwise_bridge FOLDER < port > port
 *
 * A line `time_ms current_A voltage_V temperature_C` of the pack is answered by
 * `soc soc_std status valid current_A voltage_V` once a step. `nan` stands for what is not measured. What is kept over
 * a switch-off lies in FOLDER. scripts/soc_battery.lua is the autopilot's side. */
#include "cellwise_glue.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STEP_MS (@DT_MS@u) /* the tables hold for this time step */
#define KEEP_MS (600000u) /* between two writes */
#define LINE (256)

static cellwise_glue glue;

static FILE *slot_file(const char *folder, uint32_t which, const char *mode)
{
    char path[4096];
    (void)snprintf(path, sizeof path, "%s/@NAME@_%u", folder, (unsigned)which);
    return fopen(path, mode);
}

static void read_slots(const char *folder)
{
    for (uint32_t k = 0u; k < 2u; k++) {
        FILE *const file = slot_file(folder, k, "rb");
        if (file != NULL) { /* what is cut does not pass the store's check */
            (void)fread(&glue.slots[k], sizeof glue.slots[k], 1u, file);
            (void)fclose(file);
        }
    }
}

static void write_slot(const char *folder)
{
    const uint32_t which = cellwise_glue_keep(&glue);
    FILE *const file = slot_file(folder, which, "wb");
    if (file != NULL) {
        (void)fwrite(&glue.slots[which], sizeof glue.slots[which], 1u, file);
        (void)fclose(file);
    }
}

/* Four numbers of a line; a line that is cut or garbled is passed over. */
static bool parsed(const char *line, unsigned long long *now_ms, float value[3])
{
    char *end = NULL;
    *now_ms = strtoull(line, &end, 10);
    bool is_whole = end != line;
    for (int k = 0; is_whole && (k < 3); k++) {
        const char *const from = end;
        value[k] = strtof(from, &end);
        is_whole = end != from;
    }
    return is_whole && (end[strspn(end, " \r")] == '\n');
}

int main(int count, char **argument)
{
    const char *const folder = (count > 1) ? argument[1] : ".";
    char line[LINE];
    bool is_begun = false;
    uint32_t kept_ms = 0u;
    read_slots(folder);
    while (fgets(line, LINE, stdin) != NULL) {
        unsigned long long now = 0u;
        float value[3] = {NAN, NAN, NAN};
        if (!parsed(line, &now, value)) {
            continue;
        }
        const uint32_t now_ms = (uint32_t)now;
        if (!is_begun) {
            (void)cellwise_glue_begin(&glue, now_ms, STEP_MS);
            kept_ms = now_ms;
            is_begun = true;
        }
        if (cellwise_glue_sample(&glue, now_ms, value[0], value[1], value[2])) {
            (void)printf("%.6f %.6f %u %d %.3f %.3f\n", (double)glue.soc, (double)glue.soc_std, (unsigned)glue.status,
                         cellwise_glue_is_valid(&glue) ? 1 : 0, (double)value[0], (double)value[1]);
            (void)fflush(stdout);
        }
        if (((now_ms - kept_ms) >= KEEP_MS) || cellwise_glue_has_moved(&glue)) {
            write_slot(folder);
            kept_ms = now_ms;
        }
    }
    if (is_begun && (glue.faults == 0u)) {
        write_slot(folder);
    }
    return (glue.faults == 0u) ? 0 : 1;
}
