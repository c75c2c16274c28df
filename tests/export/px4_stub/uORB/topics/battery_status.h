#pragma once
#include <cstdint>
#define ORB_ID(name) 0
struct battery_status_s {
	static constexpr uint8_t BATTERY_SOURCE_POWER_MODULE = 0;
	static constexpr uint8_t BATTERY_SOURCE_EXTERNAL = 1;
	uint64_t timestamp;
	bool connected;
	float voltage_v, current_a, remaining, temperature;
	uint8_t cell_count, source, id;
};
