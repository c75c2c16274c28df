#pragma once
#include <cmath>
#include <cstdint>
typedef uint64_t hrt_abstime;
hrt_abstime hrt_absolute_time();
