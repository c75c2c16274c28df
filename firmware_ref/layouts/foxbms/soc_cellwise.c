/* The state-estimation API of foxBMS 2 on cellwise_ekf.c: one state a string, on its mean cell. Minimum and
 * maximum are two standard deviations about the SOC; 0 and 100 % where the tables are damaged. Its API has no place
 * for the status: SE_GetStateOfChargeStatus() says it. */
#include "cellwise_cell.h"
#include "cellwise_clock.h"
#include "cellwise_store.h"
#include "database.h"
#include "os.h"
#include "state_estimation.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#define SOC_STEP_MS (@DT_MS@u)     /* the tables hold for this time step */
#define SOC_START_VARIANCE (0.0225f) /* of an initial SOC by voltage: 15 % */
#define SOC_UNKNOWN_VARIANCE (1.0f)
#define SOC_MISSING_V (-1.0f)        /* the filter takes it for a missing voltage */

typedef struct {
    cellwise_state state;
    cellwise_clock clock;
    float charge_mAs;   /* since the last sample, positive on discharge, */
    uint32_t since_ms;  /* and over how long */
    uint32_t called_ms;
    uint32_t status;    /* bits of the last step */
    bool begun;
} SOC_STRING_s;

static SOC_STRING_s soc_string[BS_NR_OF_STRINGS];

extern uint32_t SE_GetStateOfChargeStatus(uint8_t stringNumber);

/* Bisection of the OCV at rest, which rises with SOC. */
extern float_t SE_GetStateOfChargeFromVoltage(int16_t voltage_mV) {
    const cellwise_row *row = cellwise_cell.row[CELLWISE_TEMPERATURES / 2u];
    uint32_t low            = 0u;
    uint32_t high           = CELLWISE_POINTS - 1u;
    while ((high - low) > 1u) {
        const uint32_t middle = (low + high) / 2u;
        if ((row[middle].ocv_V * 1000.0f) > (float)voltage_mV) {
            high = middle;
        } else {
            low = middle;
        }
    }
    float share = (((float)voltage_mV / 1000.0f) - row[low].ocv_V) / (row[high].ocv_V - row[low].ocv_V);
    share       = fminf(fmaxf(share, 0.0f), 1.0f);
    return 100.0f * ((float)low + share) / (float)(CELLWISE_POINTS - 1u);
}

static void SOC_Show(DATA_BLOCK_SOC_s *pSocValues, uint8_t s, float soc, float variance) {
    const float band              = 2.0f * sqrtf(variance);
    pSocValues->averageSoc_perc[s] = 100.0f * soc;
    pSocValues->minimumSoc_perc[s] = 100.0f * fmaxf(soc - band, 0.0f);
    pSocValues->maximumSoc_perc[s] = 100.0f * fminf(soc + band, 1.0f);
}

/* Status bits of the last step of a string (cellwise_ekf.h). */
extern uint32_t SE_GetStateOfChargeStatus(uint8_t stringNumber) {
    return soc_string[stringNumber].status;
}

extern void SE_InitializeStateOfCharge(DATA_BLOCK_SOC_s *pSocValues, bool ccPresent, uint8_t stringNumber) {
    (void)ccPresent;
    DATA_BLOCK_MIN_MAX_s cells = {.header.uniqueId = DATA_BLOCK_ID_MIN_MAX};
    DATA_READ_DATA(&cells);
    SOC_STRING_s *one = &soc_string[stringNumber];
    const float soc   = SE_GetStateOfChargeFromVoltage(cells.averageCellVoltage_mV[stringNumber]) / 100.0f;
    one->status     = cellwise_init(&cellwise_cell, &one->state, soc, SOC_START_VARIANCE);
    one->called_ms  = OS_GetTickCount();
    cellwise_clock_begin(&one->clock, one->called_ms, SOC_STEP_MS);
    one->charge_mAs = 0.0f;
    one->since_ms   = 0u;
    one->begun      = cellwise_check_model(&cellwise_cell) == 0u; /* no step on damaged tables */
    SOC_Show(pSocValues, stringNumber, one->state.soc, one->begun ? one->state.ss : SOC_UNKNOWN_VARIANCE);
}

/* Called more often than a time step: the mean current since the last sample is what counts. */
extern void SE_CalculateStateOfCharge(DATA_BLOCK_SOC_s *pSocValues) {
    DATA_BLOCK_MIN_MAX_s cells    = {.header.uniqueId = DATA_BLOCK_ID_MIN_MAX};
    DATA_BLOCK_PACK_VALUES_s pack = {.header.uniqueId = DATA_BLOCK_ID_PACK_VALUES};
    DATA_READ_DATA(&cells, &pack);
    const uint32_t now_ms = OS_GetTickCount();
    for (uint8_t s = 0u; s < BS_NR_OF_STRINGS; s++) {
        SOC_STRING_s *one = &soc_string[s];
        float current_mA  = (float)pack.stringCurrent_mA[s];
#if defined(BS_POSITIVE_DISCHARGE_CURRENT)
        current_mA = BS_POSITIVE_DISCHARGE_CURRENT ? current_mA : -current_mA;
#elif defined(POSITIVE_DISCHARGE_CURRENT)
        current_mA = POSITIVE_DISCHARGE_CURRENT ? current_mA : -current_mA;
#endif
        if (pack.invalidStringCurrent[s] != 0u) {
            current_mA = NAN; /* the filter holds the last one, and widens the band */
        }
        one->charge_mAs += current_mA * (float)(now_ms - one->called_ms) / 1000.0f;
        one->since_ms += now_ms - one->called_ms;
        one->called_ms = now_ms;
        if (one->begun && (cellwise_clock_steps(&one->clock, now_ms) > 0u)) {
            cellwise_input in;
            cellwise_output out;
            in.current_A     = one->charge_mAs / (float)one->since_ms;
            in.voltage_V     = (cells.validMeasuredCellVoltages[s] != 0u)
                                   ? ((float)cells.averageCellVoltage_mV[s] / 1000.0f)
                                   : SOC_MISSING_V;
            in.temperature_C = cells.averageTemperature_ddegC[s] / 10.0f;
            in.sequence      = one->clock.sequence;
            one->status      = cellwise_step(&cellwise_cell, &one->state, &in, &out);
            one->charge_mAs = 0.0f;
            one->since_ms   = 0u;
            SOC_Show(pSocValues, s, out.soc, out.soc_variance);
        }
    }
}
