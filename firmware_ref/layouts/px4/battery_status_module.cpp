/* A battery_status of PX4: the power module's current and voltage through cellwise_ekf.c. Written after PX4's
 * documentation; not built in a PX4 tree by those who wrote it. */
#include "cellwise_glue.h"

#include <drivers/drv_hrt.h>
#include <px4_platform_common/defines.h>
#include <px4_platform_common/module.h>
#include <px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp>
#include <uORB/PublicationMulti.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/topics/battery_status.h>

#include <cstdio>

namespace
{
constexpr uint32_t STEP_MS = @DT_MS@u; /* the tables hold for this time step */
constexpr uint32_t KEEP_MS = 600000u; /* between two writes */
constexpr uint32_t LOOK_US = 100000u; /* a mean of the current, from so many looks */
constexpr uint8_t ID = 2u; /* beside the power module's */
const char *const KEPT[2] = {PX4_STORAGEDIR "/@NAME@_0", PX4_STORAGEDIR "/@NAME@_1"};
} // namespace

class CellwiseBattery : public ModuleBase<CellwiseBattery>, public px4::ScheduledWorkItem
{
public:
	CellwiseBattery() : ScheduledWorkItem("cellwise", px4::wq_configurations::lp_default) {}

	static int task_spawn(int argc, char *argv[]);
	static int custom_command(int argc, char *argv[]) { return print_usage("unknown command"); }
	static int print_usage(const char *reason = nullptr);

	bool init();

private:
	void Run() override;
	void publish(const battery_status_s &seen);
	void keep(uint32_t now_ms);

	uORB::Subscription _seen{ORB_ID(battery_status), 0}; /* what the power module says */
	uORB::PublicationMulti<battery_status_s> _said{ORB_ID(battery_status)};
	cellwise_glue _glue{};
	uint32_t _kept_ms{0};
	bool _begun{false};
};

static uint32_t milliseconds(hrt_abstime time_us)
{
	return static_cast<uint32_t>(time_us / 1000u);
}

bool CellwiseBattery::init()
{
	for (int k = 0; k < 2; k++) {
		FILE *file = fopen(KEPT[k], "rb");

		if (file != nullptr) { /* what is cut does not pass the store's check */
			(void)fread(&_glue.slots[k], sizeof(cellwise_stored), 1, file);
			fclose(file);
		}
	}

	ScheduleOnInterval(LOOK_US);
	return true;
}

void CellwiseBattery::Run()
{
	battery_status_s seen;

	if (should_exit()) {
		ScheduleClear();
		exit_and_cleanup();

	} else if (_seen.update(&seen)) {
		const uint32_t now_ms = milliseconds(seen.timestamp);

		if (!_begun) {
			(void)cellwise_glue_begin(&_glue, now_ms, STEP_MS);
			_kept_ms = now_ms;
			_begun = true;
		}

		/* -1 is PX4's word for a current that is not measured. */
		const bool has_current = seen.connected && !(seen.current_a < 0.f && seen.current_a > -1.0001f
						 && seen.current_a < -0.9999f);
		const float cells = seen.cell_count > 0 ? static_cast<float>(seen.cell_count) : 1.f;
		const float voltage_V = seen.connected ? seen.voltage_v / cells : NAN;

		if (cellwise_glue_sample(&_glue, now_ms, has_current ? seen.current_a : NAN, voltage_V, seen.temperature)) {
			publish(seen);
			keep(now_ms);
		}

	} else {
		/* nothing new */
	}
}

void CellwiseBattery::publish(const battery_status_s &seen)
{
	const bool valid = cellwise_glue_is_valid(&_glue);
	battery_status_s said = seen;
	said.timestamp = hrt_absolute_time();
	said.id = ID;
	said.source = battery_status_s::BATTERY_SOURCE_EXTERNAL;
	said.connected = seen.connected && _glue.faults == 0u;
	said.remaining = valid ? fminf(fmaxf(_glue.soc, 0.f), 1.f) : -1.f;
	_said.publish(said);
}

void CellwiseBattery::keep(uint32_t now_ms)
{
	if (now_ms - _kept_ms >= KEEP_MS || cellwise_glue_has_moved(&_glue)) {
		const uint32_t which = cellwise_glue_keep(&_glue);
		FILE *file = fopen(KEPT[which], "wb");

		if (file != nullptr) {
			(void)fwrite(&_glue.slots[which], sizeof(cellwise_stored), 1, file);
			fclose(file);
		}

		_kept_ms = now_ms;
	}
}

int CellwiseBattery::task_spawn(int argc, char *argv[])
{
	CellwiseBattery *instance = new CellwiseBattery();

	if (instance == nullptr) {
		return PX4_ERROR;
	}

	_object.store(instance);
	_task_id = task_id_is_work_queue;
	return instance->init() ? PX4_OK : PX4_ERROR;
}

int CellwiseBattery::print_usage(const char *reason)
{
	PRINT_MODULE_DESCRIPTION("State of charge by cellwise, as another battery_status.");
	PRINT_MODULE_USAGE_NAME("@NAME@", "driver");
	PRINT_MODULE_USAGE_COMMAND("start");
	PRINT_MODULE_USAGE_DEFAULT_COMMANDS();
	return 0;
}

extern "C" __EXPORT int @NAME@_main(int argc, char *argv[])
{
	return CellwiseBattery::main(argc, argv);
}
