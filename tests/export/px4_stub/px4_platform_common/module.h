#pragma once
#define PRINT_MODULE_DESCRIPTION(text) (void)(text)
#define PRINT_MODULE_USAGE_NAME(name, category) (void)(name)
#define PRINT_MODULE_USAGE_COMMAND(name) (void)(name)
#define PRINT_MODULE_USAGE_DEFAULT_COMMANDS() (void)0
enum { task_id_is_work_queue = -2 };
template <class T> struct Stored {
	T *pointer = nullptr;
	void store(T *to) { pointer = to; }
};
template <class T> class ModuleBase
{
public:
	static int main(int argc, char *argv[]) { return T::task_spawn(argc, argv); }
	static bool should_exit() { return false; }
	static void exit_and_cleanup() {}

protected:
	static inline Stored<T> _object;
	static inline int _task_id = -1;
};
