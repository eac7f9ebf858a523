// SPDX-License-Identifier: Apache-2.0
//
// Functions that plugin_test.cpp looks up in the plugin by name.
#pragma once

#include <atomic>

extern "C" {
using PluginStart =
    void* (*)(std::atomic<int>* destroyed);  // publishes one message to one subscriber
using PluginStop = void (*)(void* publisher);
// Subscribes, writes a byte, takes one message, writes a byte, keeps it until it reads a byte.
// Returns 0 on success.
using PluginHold = int (*)(int say_fd, int wait_fd);
}
