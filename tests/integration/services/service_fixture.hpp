// SPDX-License-Identifier: Apache-2.0
//
// Services: the fixture for tests of services within one process, and its helpers for waiting.
#pragma once

#include <tests/integration/services/services.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <agnocast/abi/heaphook.h>

#include <gmock/gmock.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <functional>
#include <future>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {

using namespace std::chrono_literals;
using test::Count;
using test::eventually;
using test::PlainNode;
using test::Repeat;
using test::Spun;

inline constexpr auto patience = 5min;

class Services : public test::SuiteDaemon {
 protected:
  static void SetUpTestSuite() {
    test::DaemonOptions options;
    options.config = "[heap]\nwindow_bytes = \"64MiB\"\n" AGNOCAST_TEST_ARENA_BASE;
    start(options);
  }
};

inline void answer(const ipc_shared_ptr<const Repeat::Request>& request,
                   ipc_shared_ptr<Repeat::Response>& response) {
  Repeat::answer(*request, *response);
}

inline ipc_shared_ptr<Repeat::Request> ask_for(const Client<Repeat>::SharedPtr& client,
                                               std::uint64_t value) {
  auto request = client->borrow_loaned_request();
  request->value = value;
  request->count = 1000;
  request->note = "a note that is too long to be kept inside of its string";
  return request;
}

template <class FutureT>
bool is_ready_soon(const FutureT& future) {
  return future.wait_for(patience) == std::future_status::ready;
}
/// Returns the code of the error that the future ends with; ok if it has a response.
template <class FutureT>
Errc error_of(FutureT& future) {
  if (!is_ready_soon(future)) return Errc::internal;
  try {
    (void)future.get();
    return Errc::ok;
  } catch (const Error& error) {
    return error.failure().code;
  }
}

/// Requests that wait for a response.
struct Kept {
  std::mutex mutex;
  std::vector<ServiceRequest<Repeat>> requests;
  auto keep() {
    return [this](ServiceRequest<Repeat> request) {
      const std::lock_guard lock(mutex);
      requests.push_back(std::move(request));
    };
  }
  std::size_t count() {
    const std::lock_guard lock(mutex);
    return requests.size();
  }
  Errc answer(const Service<Repeat>::SharedPtr& service, std::size_t index) {
    const std::lock_guard lock(mutex);
    auto response = service->borrow_loaned_response();
    if (requests[index].message()) Repeat::answer(*requests[index], *response);
    return service->send_response(requests[index], std::move(response)).code;
  }
};

}  // namespace agnocast
