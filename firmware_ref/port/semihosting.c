#include "semihosting.h"

static int32_t call(uint32_t operation, const void *argument)
{
#if defined(__riscv)
    register uint32_t a0 __asm__("a0") = operation;
    register const void *a1 __asm__("a1") = argument;
    __asm__ volatile(".option push\n .option norvc\n .balign 16\n"
                     "slli zero, zero, 0x1f\n ebreak\n srai zero, zero, 7\n .option pop"
                     : "+r"(a0)
                     : "r"(a1)
                     : "memory");
    return (int32_t)a0;
#else
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return (int32_t)r0;
#endif
}

int32_t host_open(const char *name, uint32_t mode)
{
    uint32_t length = 0u;
    while (name[length] != '\0') {
        length++;
    }
    {
        const uint32_t argument[3] = {(uint32_t)name, mode, length};
        return call(0x01u, argument);
    }
}

uint32_t host_read(int32_t file, void *to, uint32_t bytes)
{
    const uint32_t argument[3] = {(uint32_t)file, (uint32_t)to, bytes};
    return bytes - (uint32_t)call(0x06u, argument);
}

void host_write(int32_t file, const void *from, uint32_t bytes)
{
    const uint32_t argument[3] = {(uint32_t)file, (uint32_t)from, bytes};
    (void)call(0x05u, argument);
}

void host_close(int32_t file)
{
    const uint32_t argument[1] = {(uint32_t)file};
    (void)call(0x02u, argument);
}

void host_exit(uint32_t failed)
{
    const uint32_t argument[2] = {0x20026u, failed};
    for (;;) {
        (void)call((failed == 0u) ? 0x18u : 0x20u, (failed == 0u) ? (const void *)0x20026u : argument);
    }
}
