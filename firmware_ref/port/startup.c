/* Vectors and reset of a Cortex-M. Built with -fno-builtin: the loops below must stay loops. */
#include <stdint.h>

#include "semihosting.h"

extern uint32_t stack_top[];
extern uint32_t bss_start[];
extern uint32_t bss_end[];
extern uint32_t data_start[];
extern uint32_t data_end[];
extern const uint32_t data_load[];

int main(void);
void reset(void) __attribute__((noreturn));
void fault(void) __attribute__((noreturn));

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[16] = {
    (uintptr_t)stack_top, (uintptr_t)reset, (uintptr_t)fault, (uintptr_t)fault,
    (uintptr_t)fault,     (uintptr_t)fault, (uintptr_t)fault, 0,
    0,                    0,                0,                (uintptr_t)fault,
    (uintptr_t)fault,     0,                (uintptr_t)fault, (uintptr_t)fault,
};

void reset(void)
{
    const uint32_t *from = data_load;
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* CPACR: the FPU may be used */
    __asm__ volatile("dsb\n isb");
#endif
    for (uint32_t *to = data_start; to < data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = bss_start; to < bss_end; to++) {
        *to = 0u;
    }
    host_exit((uint32_t)main());
}

void fault(void)
{
    host_exit(2u);
}
