#ifndef STUB_KERNEL_H
#define STUB_KERNEL_H

#include <stdint.h>

struct k_mutex {
    int depth;
};
struct k_work {
    int unused;
};
struct k_work_delayable {
    void (*handler)(struct k_work *work);
};

#define K_FOREVER 0
#define K_MSEC(ms) (ms)
#define K_WORK_DELAYABLE_DEFINE(name, call) struct k_work_delayable name = {call}

static inline int k_mutex_init(struct k_mutex *m) { return m->depth = 0; }
static inline int k_mutex_lock(struct k_mutex *m, int wait) { (void)wait; return m->depth++; }
static inline int k_mutex_unlock(struct k_mutex *m) { return m->depth--; }
uint32_t k_uptime_get_32(void);
int k_work_schedule(struct k_work_delayable *work, int ms);

#endif
