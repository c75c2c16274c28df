#pragma once
#define PX4_OK 0
#define PX4_ERROR (-1)
#define PX4_STORAGEDIR "."
#define __EXPORT
