// SPDX-License-Identifier: Apache-2.0
//
// What plugin_test.cpp finds in the plugin by name.
#pragma once

#include <atomic>

extern "C" {
using PluginStart =
    void* (*)(std::atomic<int>* destroyed);  // publishes one message to one subscriber
using PluginStop = void (*)(void* publisher);
// Takes one message, says so by a byte, keeps it until it gets one. 0: all went well.
using PluginHold = int (*)(int say_fd, int wait_fd);
}
