/* 10^8 steps of a repeated drive: the covariance stays symmetric (it is stored as a triangle) and
 * positive, SOC within 0..1, every output finite. For three states. Reads cellwise_input records. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "cellwise_cell.h"

#define MOST_SAMPLES 1000000u

static cellwise_input drive[MOST_SAMPLES];

/* Smallest leading minor of P scaled to a unit diagonal. */
static double smallest_minor(const cellwise_state *x)
{
    const double s1 = (double)x->s1 / sqrt((double)x->ss * (double)x->p11);
    const double s2 = (double)x->s2 / sqrt((double)x->ss * (double)x->p22);
    const double p12 = (double)x->p12 / sqrt((double)x->p11 * (double)x->p22);
    const double two = 1.0 - (s1 * s1);
    const double three = 1.0 + (2.0 * s1 * s2 * p12) - (s1 * s1) - (s2 * s2) - (p12 * p12);
    return (two < three) ? two : three;
}

int main(int count, char **arguments)
{
    FILE *const file = (count > 2) ? fopen(arguments[1], "rb") : NULL;
    const double steps = (count > 2) ? atof(arguments[2]) : 0.0;
    cellwise_state x;
    double least = 1.0;
    double most = 0.0;
    double done = 0.0;
    uint32_t sequence = 0u;
    size_t samples;
    if (file == NULL) {
        return 2;
    }
    samples = fread(drive, sizeof drive[0], MOST_SAMPLES, file);
    (void)cellwise_init(&cellwise_cell, &x, 0.9f, 0.01f);
    while ((samples > 0u) && (done < steps)) {
        for (size_t k = 0u; k < samples; k++) {
            cellwise_output out;
            double minor;
            drive[k].sequence = sequence++;
            (void)cellwise_step(&cellwise_cell, &x, &drive[k], &out);
            minor = smallest_minor(&x);
            least = (minor < least) ? minor : least;
            most = ((double)out.soc_variance > most) ? (double)out.soc_variance : most;
            if (!isfinite(out.voltage_V) || !isfinite(out.innovation_V) ||
                !isfinite(out.innovation_variance_V2) || !(out.soc >= 0.0f && out.soc <= 1.0f) ||
                !(x.ss > 0.0f && x.p11 > 0.0f && x.p22 > 0.0f) ||
                ((out.status & CELLWISE_STATE_RESET) != 0u)) {
                printf("step %.0f: soc %g, status %u\n", done + (double)k, (double)out.soc, out.status);
                return 1;
            }
        }
        done += (double)samples;
    }
    printf("%.0f steps, smallest minor %.3g, largest variance of SOC %.3g\n", done, least, most);
    return (least > 0.0) ? 0 : 1;
}
