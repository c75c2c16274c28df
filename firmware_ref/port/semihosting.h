/* Files and exit of the machine that runs QEMU. */
#ifndef SEMIHOSTING_H
#define SEMIHOSTING_H

#include <stdint.h>

int32_t host_open(const char *name, uint32_t mode); /* mode 1: "rb", 5: "wb" */
uint32_t host_read(int32_t file, void *to, uint32_t bytes); /* bytes that were read */
void host_write(int32_t file, const void *from, uint32_t bytes);
void host_close(int32_t file);
void host_exit(uint32_t failed) __attribute__((noreturn));

#endif
