// SPDX-License-Identifier: Apache-2.0
//
// The roles of a pipeline's processes.
//
//   pipeline-lidar BOARD LIDAR INPUTS SCAN   four nodes in a container, in one thread: on each
//                                            go, a scan through the nodes and over the edge of
//                                            the frame
//   pipeline-concatenate BOARD               a node on each edge, of which one has messages at a
//                                            time

#include <bench/pipeline/board.hpp>
#include <bench/pipeline/edge.hpp>
#include <bench/pipeline/inputs.hpp>
#include <bench/process.hpp>

#include <base/clock.hpp>

#include <time.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::bench::pipeline {
namespace {

std::int64_t now_ns() noexcept { return static_cast<std::int64_t>(monotonic_ns()); }
/// Returns the processor time of the calling thread so far.
std::int64_t cpu_ns() noexcept {
  timespec time{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return std::int64_t{1'000'000'000} * time.tv_sec + time.tv_nsec;
}
void sleep_until(std::int64_t when_ns) noexcept {
  const timespec when{static_cast<time_t>(when_ns / 1'000'000'000), when_ns % 1'000'000'000};
  while (::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, nullptr) == EINTR) continue;
}

using Stamp = decltype(std_msgs::msg::Header::stamp);
Stamp stamp_of(std::int64_t ns) {
  Stamp stamp;
  stamp.sec = static_cast<std::int32_t>(ns / 1'000'000'000);
  stamp.nanosec = static_cast<std::uint32_t>(ns % 1'000'000'000);
  return stamp;
}

template <class Endpoint>
void wait_for_peers(Endpoint& endpoint, std::string_view edge) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (!endpoint.is_matched()) {
    if (std::chrono::steady_clock::now() > end)
      throw std::runtime_error("the processes do not find each other over " + std::string(edge));
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

/// Runs `work`, and stores its exception as the board's error.
template <class Work>
int report_failure(Board& board, Work work) {
  try {
    work();
    return 0;
  } catch (const std::exception& error) {
    board.set_error(error.what());
    // Threads of transports may still run.
    std::_Exit(1);
  }
}

void run_lidar(Board& board, std::size_t index, std::vector<Cloud> inputs) {
  const Lidar& lidar = lidars()[index];
  std::vector<std::unique_ptr<CloudSender>> senders;
  for (const Edge& edge : edges()) senders.push_back(edge.make_sender(lidar));
  for (std::size_t i = 0; i < senders.size(); ++i) wait_for_peers(*senders[i], edges()[i].name);
  board.head().ready.fetch_add(1);
  // Not only until the last frame: its message may still be in transit, and needs its sender.
  for (;;) {
    wait(board.head().go[index]);
    if (board.head().is_over != 0) return;
    Frame& frame = board.frames()[board.head().current];
    CloudSender& sender = *senders.at(frame.edge);
    Cloud& scan = inputs.at(frame.input);
    scan.header.stamp = stamp_of(frame.released_ns);
    sleep_until(frame.released_ns);
    const std::int64_t began_cpu_ns = cpu_ns();
    Cloud* out = nullptr;
    preprocess(lidar, scan, [&]() -> Cloud& { return *(out = &sender.borrow()); });
    frame.chains[index] = {cpu_ns() - began_cpu_ns, now_ns(), out->data.size()};
    sender.send();
  }
}

/// Concatenate's node on one edge. Its callbacks run one at a time.
class Concatenate {
 public:
  explicit Concatenate(Board& board) : board_(board) {}

  void take(std::size_t lidar, std::shared_ptr<const Cloud> cloud) {
    const std::int64_t received_ns = now_ns();
    Frame& frame = board_.frames()[board_.head().current];
    const std::string name = lidars()[lidar].name;
    if (!is_of_points(*cloud)) throw std::runtime_error("a cloud of " + name + " came changed");
    if (cloud->header.stamp != stamp_of(frame.released_ns) || clouds_[lidar] != nullptr)
      throw std::runtime_error("a cloud of " + name + " came out of turn");
    frame.received_ns[lidar] = received_ns;
    clouds_[lidar] = std::move(cloud);
    for (const auto& one : clouds_) {
      if (one == nullptr) return;
    }
    finish(frame);
  }

 private:
  void finish(Frame& frame) {
    const std::int64_t began_cpu_ns = cpu_ns();
    std::array<Part, lidar_count> parts;
    for (std::size_t i = 0; i < lidar_count; ++i)
      parts[i] = {clouds_[i].get(), lidars()[i].in_vehicle};
    Cloud whole;
    concatenate(parts, whole);
    frame.cpu_ns = cpu_ns() - began_cpu_ns;
    frame.done_ns = now_ns();
    frame.points = whole.width;
    frame.checksum = checksum_of(whole);
    clouds_ = {};
    ::sem_post(&board_.head().done);
  }

  Board& board_;
  std::array<std::shared_ptr<const Cloud>, lidar_count> clouds_;
};

void run_concatenate(Board& board) {
  std::vector<std::unique_ptr<Concatenate>> nodes;
  std::vector<std::unique_ptr<CloudReceiver>> receivers;
  for (const Edge& edge : edges()) {
    nodes.push_back(std::make_unique<Concatenate>(board));
    receivers.push_back(edge.make_receiver(
        [node = nodes.back().get()](std::size_t lidar, std::shared_ptr<const Cloud> cloud) {
          node->take(lidar, std::move(cloud));
        }));
  }
  for (std::size_t i = 0; i < receivers.size(); ++i) wait_for_peers(*receivers[i], edges()[i].name);
  std::vector<std::jthread> threads;
  for (const auto& receiver : receivers) {
    threads.emplace_back(
        [&board, &receiver] { (void)report_failure(board, [&receiver] { receiver->run(); }); });
  }
  board.head().ready.fetch_add(1);
  wait(board.head().over);
  for (const auto& receiver : receivers) receiver->stop();
}

int be_lidar(const std::vector<std::string>& arguments) {
  Board board(Board::Inherited{std::stoi(arguments.at(0))});
  return report_failure(board, [&] {
    const std::size_t index = std::stoul(arguments.at(1));
    run_lidar(board, index, inputs_of(index, std::stoul(arguments.at(2)), arguments.at(3)));
  });
}
int be_concatenate(const std::vector<std::string>& arguments) {
  Board board(Board::Inherited{std::stoi(arguments.at(0))});
  return report_failure(board, [&] { run_concatenate(board); });
}

const RegisterRole lidar_role("pipeline-lidar", be_lidar);
const RegisterRole concatenate_role("pipeline-concatenate", be_concatenate);

}  // namespace
}  // namespace agnocast::bench::pipeline
