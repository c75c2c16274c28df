#ifndef STUB_SETTINGS_H
#define STUB_SETTINGS_H

#include <stddef.h>
#include <sys/types.h>

typedef ssize_t (*settings_read_cb)(void *argument, void *data, size_t size);

extern int (*const stub_set)(const char *key, size_t size, settings_read_cb read, void *argument);
extern int (*const stub_commit)(void);
int settings_save_one(const char *name, const void *value, size_t size);

#define SETTINGS_STATIC_HANDLER_DEFINE(name, tree, get, set, commit, export) \
    int (*const stub_set)(const char *, size_t, settings_read_cb, void *) = set; \
    int (*const stub_commit)(void) = commit

#endif
