/* Runs the module: a line `time_ms current voltage temperature`, four cells; prints what is published. */
#include <px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp>
#include <uORB/topics/battery_status.h>

#include <cstdio>

battery_status_s stub_seen, stub_said;
uint64_t hrt_absolute_time();
uint64_t hrt_absolute_time() { return stub_seen.timestamp; }
extern "C" int cellwise_main(int argc, char *argv[]);

int main(int argc, char **argv)
{
	double now_ms, current, voltage, temperature;
	(void)cellwise_main(argc, argv);
	while (scanf("%lf %lf %lf %lf", &now_ms, &current, &voltage, &temperature) == 4) {
		stub_said = battery_status_s{};
		stub_seen = battery_status_s{};
		stub_seen.timestamp = static_cast<uint64_t>(1000.0 * now_ms);
		stub_seen.connected = true;
		stub_seen.cell_count = 4;
		stub_seen.voltage_v = static_cast<float>(4.0 * voltage);
		stub_seen.current_a = static_cast<float>(current);
		stub_seen.temperature = static_cast<float>(temperature);
		px4::ScheduledWorkItem::only->go();
		if (stub_said.id != 0) {
			printf("%.6f 0 0 %d %.3f %.3f\n", static_cast<double>(stub_said.remaining), stub_said.source,
			       static_cast<double>(stub_said.current_a), static_cast<double>(stub_said.voltage_v));
		}
	}
	return 0;
}
