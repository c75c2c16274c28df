// Steps the filter through the test vector and compares every bit.
extern "C" {
#include "cellwise_cell.h"
#include "test_vector.h"
}

void setup() {
    cellwise_state state;
    cellwise_output out;
    unsigned wrong = 0;
    Serial.begin(115200);
    cellwise_init(&cellwise_cell, &state, CELLWISE_VECTOR_SOC, CELLWISE_VECTOR_VARIANCE);
    for (unsigned k = 0; k < CELLWISE_VECTOR_SAMPLES; k++) {
        cellwise_step(&cellwise_cell, &state, &cellwise_vector_inputs[k], &out);
        wrong += memcmp(&out, &cellwise_vector_outputs[k], sizeof out) != 0;
    }
    Serial.println(wrong == 0 ? "every bit as expected" : "DIFFERENT BITS");
}

void loop() {}
