#include "cellwise_gauge.h"
