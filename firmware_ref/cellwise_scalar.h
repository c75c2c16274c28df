/* Part of cellwise_ekf.c. Equations of single numbers. Printed from src/cellwise/estimate by `python -m
 * cellwise.printing`; do not edit. */
#ifndef CELLWISE_SCALAR_H
#define CELLWISE_SCALAR_H

#include "cellwise_arithmetic.h"

/* Held above low. */
static float at_least(float x, float low)
{
    return (x < low) ? low : x;
}

/* Held below high. */
static float at_most(float x, float high)
{
    return (x < high) ? x : high;
}

/* Held within low..high. */
static float clip(float x, float low, float high)
{
    return (x < low) ? low : ((x > high) ? high : x);
}

/* How far a number is outside of low..high, 0 within. */
static float distance_beyond(float x, float low, float high)
{
    return at_least(at_least(low - x, x - high), 0.0f);
}

/* What an exponential adds to 1, to its third order: an embedded target has no other. */
static float exponential_rise(float x)
{
    return x * (1.0f + (x * (0.5f + (x * (1.0f / 6.0f)))));
}

/* Factor on a resistance whose voltage follows asinh, asinh(y) / y, 1 at small currents. y is its resistance times
 * the current over that voltage. As a fraction that is within 0.05 % of it up to y = 60, because an embedded target
 * has no logarithm whose bits are the same everywhere. */
static float charge_transfer(float overvoltage)
{
    const float y = magnitude(overvoltage);
    const float above = 1.0f + (y * (0x1.52cbf6p-1f + (y * (0x1.af8c1ap-2f + (y * 0.01126451f)))));
    const float below = 0x1.52cbf6p-1f + (y * (0x1.2f92eap-1f + (y * (0x1.e9c80ep-4f + (y * 0.00170013f)))));
    return above / (1.0f + (y * below));
}

#endif
