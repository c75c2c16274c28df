/* libFuzzer: bytes make a state, a start and samples. Run under address and undefined sanitizers. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "cellwise_cell.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    cellwise_state x;
    float start[2];
    if (size < (sizeof x + sizeof start)) {
        return 0;
    }
    memcpy(start, data, sizeof start);
    data += sizeof start;
    size -= sizeof start;
    if ((data[0] & 1u) != 0u) {
        (void)cellwise_init(&cellwise_cell, &x, start[0], start[1]);
        if (!(x.soc >= 0.0f && x.soc <= 1.0f)) {
            __builtin_trap();
        }
    } else {
        memcpy(&x, data, sizeof x);
    }
    data += sizeof x;
    size -= sizeof x;
    while (size >= sizeof(cellwise_input)) {
        cellwise_input in;
        cellwise_output out;
        memcpy(&in, data, sizeof in);
        data += sizeof in;
        size -= sizeof in;
        (void)cellwise_step(&cellwise_cell, &x, &in, &out);
        if (!(out.soc >= 0.0f && out.soc <= 1.0f) || !isfinite(out.soc_variance) ||
            !isfinite(out.voltage_V) || !isfinite(out.innovation_V) ||
            !(out.innovation_variance_V2 > 0.0f) || !isfinite(out.innovation_variance_V2)) {
            __builtin_trap();
        }
    }
    return 0;
}
