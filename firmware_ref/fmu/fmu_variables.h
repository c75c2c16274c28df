/* Written by `cellwise export`; do not edit. */
#ifndef FMU_VARIABLES_H
#define FMU_VARIABLES_H

#define CELLWISE_FMU_CELL @CELL@
#define FMU_TOKEN "@TOKEN@"
#define FMU_DT_S @DT_S@
#define FMU_STATUS_NOT_SHOWN @HIDDEN@u
#define FMU_START {@START@}

#endif
