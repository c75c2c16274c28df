/* What soc_cellwise.c has beside foxBMS's state-estimation API. */
#ifndef SOC_CELLWISE_H
#define SOC_CELLWISE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Where states are kept over a switch-off: two slots for each string, in blocks of the FRAM, say. */
typedef struct {
    void (*read)(uint8_t stringNumber, uint8_t slot, void *pData, uint32_t bytes);
    void (*write)(uint8_t stringNumber, uint8_t slot, const void *pData, uint32_t bytes);
} SOC_STORE_s;

/* Before SE_InitializeStateOfCharge(); without it nothing is kept. */
extern void SE_SetStateOfChargeStore(const SOC_STORE_s *pStore);

/* Keep the state now: before the power goes, and before new tables; every ten minutes it is kept anyway. */
extern void SE_KeepStateOfCharge(uint8_t stringNumber);

/* Status bits of the last step of a string (cellwise_ekf.h). */
extern uint32_t SE_GetStateOfChargeStatus(uint8_t stringNumber);

/* Whether tables are whole, and current and voltage there. */
extern bool SE_IsStateOfChargeValid(uint8_t stringNumber);

#ifdef __cplusplus
}
#endif

#endif
