#pragma once
#include <cstdint>
namespace px4
{
struct wq_config_t {
};
namespace wq_configurations
{
static constexpr wq_config_t lp_default{};
}
class ScheduledWorkItem
{
public:
	static inline ScheduledWorkItem *only = nullptr;
	ScheduledWorkItem(const char *, const wq_config_t &) { only = this; }
	virtual ~ScheduledWorkItem() = default;
	void ScheduleOnInterval(uint32_t) {}
	void ScheduleClear() {}
	void go() { Run(); }

protected:
	virtual void Run() = 0;
};
} // namespace px4
