// SPDX-License-Identifier: Apache-2.0
//
// What plugin_test.cpp finds in the plugin by name.
#pragma once

#include <atomic>

extern "C" {
using PluginStart =
    void* (*)(std::atomic<int>* destroyed);  // publishes one message to one subscriber
using PluginStop = void (*)(void* publisher);
// Subscribes, says so by a byte, takes one message, says so, keeps it until it gets a byte. 0: all
// went well.
using PluginHold = int (*)(int say_fd, int wait_fd);
}
