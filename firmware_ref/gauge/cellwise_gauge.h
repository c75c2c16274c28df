/* What `cellwise certify --gauge SOURCE.c` calls: two functions of a gauge, and two it may have.
 *
 * Positive current is discharge; ampere, volt, degC, second. Every start of the power is a process
 * of its own: static memory is what the linker made it. */
#ifndef CELLWISE_GAUGE_H
#define CELLWISE_GAUGE_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    float capacity_Ah, r0_ohm, soc0, dt_s; /* r0 at mid SOC, 25 degC; soc0: what the gauge is told */
    int points;                            /* of the OCV */
    const float *soc, *ocv_V;              /* the model's OCV, rising; theirs for as long as it runs */
} gauge_config;

void gauge_init(const gauge_config *config);

/* SOC, 0..1, after the interval that ends now; *soc_std its deviation, or NaN if the gauge has none.
 * A sample that was lost is not handed over: the next interval is longer. */
float gauge_step(float current_A, float voltage_V, float temperature_C, float dt_s, float *soc_std);

/* A gauge that keeps more than its SOC over a restart has these two as well. `gauge_save` writes at
 * most `size` bytes and returns how many; `gauge_restore`, called after `gauge_init`, returns 0 for
 * bytes that are no whole record: power is lost in the middle of a write, too. Without them the
 * bench keeps the SOC that was said last, and tells it as `soc0`. */
unsigned gauge_save(void *record, unsigned size);
int gauge_restore(const void *record, unsigned size);

#ifdef __cplusplus
}
#endif

#endif
