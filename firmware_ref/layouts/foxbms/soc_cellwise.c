/* The state-estimation API of foxBMS 2 on cellwise_ekf.c: one state a string, on its mean cell. Minimum and
 * maximum are two standard deviations about the SOC; 0 and 100 % where it is not valid, or the tables are damaged. Its
 * API has no place for the status: SE_GetStateOfChargeStatus() says it. Written after foxBMS's documentation; not built
 * in its tree by those who wrote it. */
#include "cellwise_glue.h"
#include "database.h"
#include "os.h"
#include "soc_cellwise.h"
#include "state_estimation.h"

#include <stddef.h>

#define SOC_STEP_MS (@DT_MS@u)     /* the tables hold for this time step */
#define SOC_START_VARIANCE (0.0225f) /* of an initial SOC by voltage: 15 % */
#define SOC_KEEP_MS (600000u)        /* between two writes */
#define SOC_MISSING_V (-1.0f)        /* the filter takes it for a missing voltage */

static cellwise_glue soc_string[BS_NR_OF_STRINGS];
static uint32_t soc_kept_ms[BS_NR_OF_STRINGS];
static SOC_STORE_s soc_store;

extern void SE_SetStateOfChargeStore(const SOC_STORE_s *pStore) {
    soc_store = *pStore;
}

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

static void SOC_Show(DATA_BLOCK_SOC_s *pSocValues, uint8_t s) {
    const cellwise_glue *one       = &soc_string[s];
    const float band               = SE_IsStateOfChargeValid(s) ? (2.0f * one->soc_std) : 1.0f;
    pSocValues->averageSoc_perc[s] = 100.0f * one->soc;
    pSocValues->minimumSoc_perc[s] = 100.0f * fmaxf(one->soc - band, 0.0f);
    pSocValues->maximumSoc_perc[s] = 100.0f * fminf(one->soc + band, 1.0f);
}

extern void SE_KeepStateOfCharge(uint8_t stringNumber) {
    if (soc_store.write != NULL) {
        cellwise_glue *one  = &soc_string[stringNumber];
        const uint32_t slot = cellwise_glue_keep(one);
        soc_store.write(stringNumber, (uint8_t)slot, &one->slots[slot], (uint32_t)sizeof(cellwise_stored));
        soc_kept_ms[stringNumber] = OS_GetTickCount();
    }
}

extern uint32_t SE_GetStateOfChargeStatus(uint8_t stringNumber) {
    return soc_string[stringNumber].status;
}

extern bool SE_IsStateOfChargeValid(uint8_t stringNumber) {
    const cellwise_glue *one = &soc_string[stringNumber];
    return (one->faults == 0u) && ((one->status & CELLWISE_GLUE_BLIND) == 0u);
}

extern void SE_InitializeStateOfCharge(DATA_BLOCK_SOC_s *pSocValues, bool ccPresent, uint8_t stringNumber) {
    (void)ccPresent;
    DATA_BLOCK_MIN_MAX_s cells = {.header.uniqueId = DATA_BLOCK_ID_MIN_MAX};
    DATA_READ_DATA(&cells);
    cellwise_glue *one = &soc_string[stringNumber];
    for (uint8_t slot = 0u; (soc_store.read != NULL) && (slot < 2u); slot++) {
        soc_store.read(stringNumber, slot, &one->slots[slot], (uint32_t)sizeof(cellwise_stored));
    }
    soc_kept_ms[stringNumber] = OS_GetTickCount();
    (void)cellwise_glue_begin(one, soc_kept_ms[stringNumber], SOC_STEP_MS);
    const bool isRestored = (one->restored == 0u) || (one->restored == CELLWISE_OTHER_MODEL);
    if (!isRestored && (cells.validMeasuredCellVoltages[stringNumber] != 0u)) { /* without one the average is 0 */
        const float soc = SE_GetStateOfChargeFromVoltage(cells.averageCellVoltage_mV[stringNumber]) / 100.0f;
        cellwise_glue_start(one, soc, SOC_START_VARIANCE);
    }
    SOC_Show(pSocValues, stringNumber);
}

/* Called more often than a time step: the mean current since the last sample is what counts. */
extern void SE_CalculateStateOfCharge(DATA_BLOCK_SOC_s *pSocValues) {
    DATA_BLOCK_MIN_MAX_s cells    = {.header.uniqueId = DATA_BLOCK_ID_MIN_MAX};
    DATA_BLOCK_PACK_VALUES_s pack = {.header.uniqueId = DATA_BLOCK_ID_PACK_VALUES};
    DATA_READ_DATA(&cells, &pack);
    const uint32_t now_ms = OS_GetTickCount();
    for (uint8_t s = 0u; s < BS_NR_OF_STRINGS; s++) {
        float current_mA = (float)pack.stringCurrent_mA[s];
#if defined(BS_POSITIVE_DISCHARGE_CURRENT)
        current_mA = BS_POSITIVE_DISCHARGE_CURRENT ? current_mA : -current_mA;
#elif defined(POSITIVE_DISCHARGE_CURRENT)
        current_mA = POSITIVE_DISCHARGE_CURRENT ? current_mA : -current_mA;
#endif
        if (pack.invalidStringCurrent[s] != 0u) {
            current_mA = NAN; /* the filter holds the last one, and widens the band */
        }
        const float voltage_V =
            (cells.validMeasuredCellVoltages[s] != 0u) ? ((float)cells.averageCellVoltage_mV[s] / 1000.0f) : SOC_MISSING_V;
        const float temperature_C =
            (cells.validMeasuredCellTemperatures[s] != 0u) ? (cells.averageTemperature_ddegC[s] / 10.0f) : NAN;
        if (cellwise_glue_sample(&soc_string[s], now_ms, current_mA / 1000.0f, voltage_V, temperature_C)) {
            SOC_Show(pSocValues, s);
            if (((now_ms - soc_kept_ms[s]) >= SOC_KEEP_MS) || cellwise_glue_has_moved(&soc_string[s])) {
                SE_KeepStateOfCharge(s);
            }
        }
    }
}
