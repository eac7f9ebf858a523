// SPDX-License-Identifier: Apache-2.0
//
// Fixture of the tests of executors and callback groups: the public interface with a real daemon,
// publishers in this process and (where messages flow meanwhile) in a second one.
#pragma once

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/messages/error_of.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {

using namespace std::chrono_literals;
using test::error_of;
using test::eventually;
using test::Number;
using Message = ipc_shared_ptr<const Number>;

class ExecutorFixture : public test::SuiteDaemon {
 protected:
  static void publish(Publisher<Number>& publisher, std::uint64_t value) {
    auto number = publisher.borrow_loaned_message();
    number->value = value;
    ASSERT_TRUE(publisher.publish(std::move(number)));
  }
};

/// The values that callbacks got, from any thread.
struct Seen {
  std::mutex mutex;
  std::vector<std::uint64_t> values;
  std::vector<std::thread::id> threads;
  void add(std::uint64_t value) {
    const std::lock_guard lock(mutex);
    values.push_back(value);
    threads.push_back(std::this_thread::get_id());
  }
  std::size_t count() {
    const std::lock_guard lock(mutex);
    return values.size();
  }
};

}  // namespace agnocast
