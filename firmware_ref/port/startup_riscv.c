/* Reset of a RISC-V without a C library. Built with -fno-builtin: the loops below must stay loops. */
#include <stddef.h>
#include <stdint.h>

#include "semihosting.h"

extern uint32_t bss_start[];
extern uint32_t bss_end[];

int main(void);
void begin(void) __attribute__((noreturn, used));
void fault(void) __attribute__((noreturn, used, aligned(4)));
void *memcpy(void *to, const void *from, size_t bytes);
void *memset(void *to, int value, size_t bytes);

__asm__(".section .start, \"ax\"\n"
        ".option arch, +zicsr\n"
        ".globl reset\n"
        "reset:\n"
        "la sp, stack_top\n"
        "la t0, fault\n"
        "csrw mtvec, t0\n"
#if defined(__riscv_flen)
        "li t0, 0x2000\n" /* mstatus.FS: the FPU may be used */
        "csrs mstatus, t0\n"
#endif
        "j begin\n"
        ".text\n");

void begin(void)
{
    for (uint32_t *to = bss_start; to < bss_end; to++) {
        *to = 0u;
    }
    host_exit((uint32_t)main());
}

void fault(void)
{
    host_exit(2u);
}

void *memcpy(void *to, const void *from, size_t bytes)
{
    for (size_t k = 0u; k < bytes; k++) {
        ((uint8_t *)to)[k] = ((const uint8_t *)from)[k];
    }
    return to;
}

void *memset(void *to, int value, size_t bytes)
{
    for (size_t k = 0u; k < bytes; k++) {
        ((uint8_t *)to)[k] = (uint8_t)value;
    }
    return to;
}
