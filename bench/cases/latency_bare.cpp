// SPDX-License-Identifier: Apache-2.0
//
// One process has both ends: a publisher, and a subscription used only by take(); their depth is
// ROS 2's usual 10. Calls are timed in batches (below the depth, so nothing is lost), because the
// clock alone takes as long as one of them. Publishers run the reclamation scan in every eighth
// publish only (docs/protocol.md, deferred scan): a batch has one, unless the control thread has
// just run it. Medians of all batches, minus an empty batch, so rare events are excluded: growth of
// the heap, another thread with the same mutex. The next borrow destroys messages that leave the
// queue; the table includes it.

#include <agnocast/agnocast.hpp>
#include <bench/cases/latency_bare.hpp>
#include <bench/cpus.hpp>
#include <bench/figures.hpp>
#include <bench/lane.hpp>
#include <bench/process.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <sched.h>
#include <nlohmann/json.hpp>

#include <array>
#include <cstdio>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bench {
namespace {

using Cloud = sensor_msgs::msg::PointCloud2;
constexpr std::size_t batch = 8, depth = 10, payload_bytes = 1024;

// Returns nanoseconds per call, measured for `batch` calls.
template <class Call>
double time_of(Call call) {
  const std::int64_t begin_ns = now_ns();
  for (std::size_t i = 0; i < batch; ++i) call(i);
  return static_cast<double>(now_ns() - begin_ns) / batch;
}

class Bench {
 public:
  Bench()
      : node_("bench_calls"),
        publisher_(node_.create_publisher<Cloud>("/bench/calls", depth)),
        subscription_(node_.create_subscription<Cloud>("/bench/calls", depth)) {}

  bool is_matched() const { return publisher_->get_linked_subscription_count() == 1; }

  void turn() {
    borrow_ns.push_back(
        time_of([this](std::size_t i) { loans_[i] = publisher_->borrow_loaned_message(); }));
    for (auto& loan : loans_) loan->data.resize(payload_bytes);
    empty_ns.push_back(time_of([](std::size_t) {}));
    mutex_clock_ns.push_back(time_of([this](std::size_t) {
      const std::lock_guard lock(mutex_);
      latest_ns_ = now_ns();
    }));
    publish_ns.push_back(time_of([this](std::size_t i) {
      if (!publisher_->publish(std::move(loans_[i]))) ++failures_;
    }));
    take_ns.push_back(time_of([this](std::size_t) {
      if (!subscription_->take()) ++failures_;  // released at once
    }));
    if (failures_ != 0) throw std::runtime_error("a message was not published, or not taken");
  }

  std::vector<double> empty_ns, mutex_clock_ns, borrow_ns, publish_ns, take_ns;

 private:
  Node node_;
  Publisher<Cloud>::SharedPtr publisher_;
  PollingSubscriber<Cloud>::SharedPtr subscription_;
  std::array<ipc_shared_ptr<Cloud>, batch> loans_;
  std::mutex mutex_;
  volatile std::int64_t latest_ns_ = 0;
  std::size_t failures_ = 0;
};

int be_calls(const std::vector<std::string>& arguments) {
  try {
    (void)pin_to(cpus().first);  // only for steadier times
    Bench bench;
    const std::int64_t end_ns = now_ns() + 10'000'000'000;
    while (!bench.is_matched()) {
      if (now_ns() > end_ns) throw std::runtime_error("no match");
      ::sched_yield();
    }
    const std::size_t batches = std::stoul(arguments.at(0));
    for (std::size_t i = 0; i < batches; ++i) bench.turn();
    const double empty = median(bench.empty_ns), borrow = median(bench.borrow_ns) - empty,
                 publish = median(bench.publish_ns) - empty, take = median(bench.take_ns) - empty;
    const nlohmann::json figures = {{"mutex_clock", median(bench.mutex_clock_ns) - empty},
                                    {"borrow", borrow},
                                    {"publish", publish},
                                    {"take and release", take},
                                    {"borrow, publish, take, release", borrow + publish + take}};
    std::printf("%s\n", figures.dump().c_str());
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "agnocast-bench: bare calls: %s\n", error.what());
    return 1;
  }
}

const RegisterRole calls_role("calls", be_calls);

}  // namespace

BareCalls measure_bare_calls(std::size_t rounds, std::size_t batches, Services& services,
                             const std::function<void()>& step) {
  std::vector<std::string> environment = services.variables("agnocastd");
  environment.push_back("LD_PRELOAD=" + path_of("libagnocast_heaphook.so"));
  std::vector<double> mutex_clock;
  BareCalls calls{.mutex_clock_ns = 0,
                  .calls = {{"borrow"},
                            {"publish", true},
                            {"take and release", true},
                            {"borrow, publish, take, release"}}};
  for (std::size_t round = 0; round < rounds; ++round) {
    step();
    Process process({.command = as_role("calls", {std::to_string(batches)}),
                     .environment = environment,
                     .has_pipes = true});
    const nlohmann::json figures = nlohmann::json::parse(process.line());
    mutex_clock.push_back(figures.at("mutex_clock"));
    for (BareCall& call : calls.calls) {
      call.ns.push_back(figures.at(call.name));
      call.ratios.push_back(call.ns.back() / mutex_clock.back());
    }
    if (process.wait(std::chrono::seconds(10)) != 0)
      throw std::runtime_error("bare calls: the process did not end well");
  }
  calls.mutex_clock_ns = median(mutex_clock);
  return calls;
}

}  // namespace agnocast::bench
