/* Runs a gauge through a life, within limits: gauge_main LIFE ANSWERS.
 *
 * LIFE is a header, two cells' configurations with their OCV, and samples. Each start of the power is
 * a child of its own, so static memory begins anew; answers stand in shared memory, so that what was
 * said before a crash is kept. */
#define _DEFAULT_SOURCE
#include "cellwise_gauge.h"

#include <fcntl.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#pragma weak gauge_save
#pragma weak gauge_restore

enum { RECORD_BYTES = 4096, SAVE = 1, RESTART = 2, TORN = 3, UPDATED = 4 };

typedef struct {
    uint32_t samples, points, cpu_s, memory_bytes;
} head;

typedef struct {
    float current_A, voltage_V, temperature_C, dt_s;
    uint32_t event;
} sample;

typedef struct {
    float soc, soc_std;
} answer;

typedef struct {
    uint32_t bytes; /* of the record, 0: empty */
    float soc;      /* said last */
    unsigned char record[RECORD_BYTES];
} slot;

/* What non-volatile memory holds, beside the answers in shared memory. */
typedef struct {
    uint32_t done, newest, off; /* next sample, newest slot, whether it was the power that ended */
    slot slots[2];
} kept;

static void limit(int what, rlim_t most)
{
    struct rlimit one = {most, most};
    (void)setrlimit(what, &one);
}

static void save(kept *own, float soc, int torn)
{
    slot *to = &own->slots[1u - own->newest];
    unsigned char record[RECORD_BYTES];
    uint32_t bytes = gauge_save ? gauge_save(record, RECORD_BYTES) : 0u;
    bytes = bytes > RECORD_BYTES ? RECORD_BYTES : bytes;
    memcpy(to->record, record, torn ? bytes / 2u : bytes);
    to->bytes = bytes;
    if (gauge_save || !torn) { /* a single number is written whole or not at all */
        to->soc = torn ? NAN : soc;
        own->newest = 1u - own->newest;
    }
}

static void start(const gauge_config *of, kept *own, int restored)
{
    gauge_config config = *of;
    uint32_t k, which = own->newest;
    for (k = 2u; restored && k-- > 0u;) { /* the newest that is a number */
        const slot *from = &own->slots[k ? 1u - which : which];
        if (!isnan(from->soc)) config.soc0 = from->soc;
    }
    gauge_init(&config);
    for (k = 0u; restored && gauge_restore && k < 2u; k++, which = 1u - which) {
        const slot *from = &own->slots[which];
        if (from->bytes != 0u && gauge_restore(from->record, from->bytes)) return;
    }
}

static void run(const head *of, const gauge_config *config, const sample *in, answer *out,
                kept *own)
{
    uint32_t k = own->done, first = k;
    limit(RLIMIT_CPU, of->cpu_s);
    (void)alarm(2u * of->cpu_s); /* one that waits uses no processor */
    limit(RLIMIT_AS, of->memory_bytes);
    limit(RLIMIT_FSIZE, 0);
    limit(RLIMIT_CORE, 0);
    start(config, own, k != 0u);
    for (; k < of->samples; k++) {
        answer one = {NAN, NAN};
        own->done = k;
        if (k != first && in[k].event >= RESTART) {
            if (in[k].event != RESTART) save(own, out[k - 1u].soc, in[k].event == TORN);
            own->off = 1u;
            _exit(0);
        }
        if (in[k].event == SAVE && k) save(own, out[k - 1u].soc, 0);
        one.soc = gauge_step(in[k].current_A, in[k].voltage_V, in[k].temperature_C, in[k].dt_s,
                             &one.soc_std);
        out[k] = one;
    }
    own->done = k;
    _exit(0);
}

static void *mapped(const char *path, int writable, size_t *bytes)
{
    struct stat about;
    int file = open(path, writable ? O_RDWR : O_RDONLY);
    if (file < 0 || fstat(file, &about) != 0) return MAP_FAILED;
    *bytes = (size_t)about.st_size;
    return mmap(NULL, *bytes, writable ? PROT_READ | PROT_WRITE : PROT_READ,
                writable ? MAP_SHARED : MAP_PRIVATE, file, 0);
}

int main(int count, char **argument)
{
    size_t bytes = 0;
    const unsigned char *life = count == 3 ? mapped(argument[1], 0, &bytes) : MAP_FAILED;
    answer *out = count == 3 ? mapped(argument[2], 1, &bytes) : MAP_FAILED;
    kept *own = mmap(NULL, sizeof(kept), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    gauge_config configs[2];
    head of;
    const float *number;
    const sample *in;
    int k, updated = 0;
    if (life == MAP_FAILED || (void *)out == MAP_FAILED || (void *)own == MAP_FAILED) return 120;
    memcpy(&of, life, sizeof of);
    number = (const float *)(const void *)(life + sizeof of);
    for (k = 0; k < 2; k++) {
        gauge_config one = {number[0], number[1], number[2], number[3], (int)of.points, number + 4,
                            number + 4 + of.points};
        configs[k] = one;
        number += 4u + 2u * of.points;
    }
    in = (const sample *)(const void *)number;
    own->slots[0].soc = own->slots[1].soc = NAN;
    while (own->done < of.samples) {
        int status = 0;
        pid_t child;
        updated |= in[own->done].event == UPDATED;
        own->off = 0u;
        child = fork();
        if (child == 0) run(&of, &configs[updated], in, out, own);
        if (child < 0 || waitpid(child, &status, 0) != child) return 121;
        if (WIFSIGNALED(status)) return 64 + (WTERMSIG(status) & 31);
        if (own->done != of.samples && !own->off) return 122; /* it ended on its own account */
    }
    return 0;
}
