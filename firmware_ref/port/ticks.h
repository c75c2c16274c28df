/* Counts instructions in QEMU with -icount shift=0: SysTick of a Cortex-M, minstret of a RISC-V. */
#ifndef TICKS_H
#define TICKS_H

#include <stdint.h>

#if defined(__riscv)
#define TICKS_MASK 0xFFFFFFFFu
#define STACK_POINTER(to) __asm__ volatile("mv %0, sp" : "=r"(to))

static inline void ticks_begin(void)
{
}

static inline uint32_t ticks(void)
{
    uint32_t now;
    __asm__ volatile(".option push\n .option arch, +zicsr\n csrr %0, minstret\n .option pop" : "=r"(now));
    return now;
}
#else
#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)
#define TICKS_MASK 0xFFFFFFu
#define STACK_POINTER(to) __asm__ volatile("mov %0, sp" : "=r"(to))

static inline void ticks_begin(void)
{
    SYST_RVR = TICKS_MASK;
    SYST_CSR = 5u;
}

static inline uint32_t ticks(void) /* it counts down */
{
    return TICKS_MASK - SYST_CVR;
}
#endif

#endif
