/* Written by `cellwise export`; do not edit. */
#ifndef CELLWISE_CELL_H
#define CELLWISE_CELL_H

#include "cellwise_ekf.h"

#ifdef __cplusplus
extern "C" {
#endif

extern const cellwise_model cellwise_cell;

#ifdef __cplusplus
}
#endif

#endif
