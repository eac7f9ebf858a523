// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/run.hpp>

#include <bench/pipeline/board.hpp>
#include <bench/pipeline/edge.hpp>
#include <bench/pipeline/inputs.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>

#include <base/clock.hpp>

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <thread>

namespace agnocast::bench::pipeline {
namespace {

constexpr std::int64_t millisecond = 1'000'000;
// Longer than any frame takes on a busy machine, and than making the inputs in a debug build.
constexpr std::int64_t frame_patience_ns = 10'000 * millisecond;
constexpr std::int64_t start_patience_ns = 60'000 * millisecond;
// Between announcing a frame and its release, so that the LiDARs sleep by then.
constexpr std::int64_t notice_ns = 5 * millisecond;

class Conductor {
 public:
  explicit Conductor(const Settings& settings)
      : settings_(settings),
        outputs_(outputs_of(settings.inputs, settings.scan)),
        board_((settings.warm_up + settings.rounds) * settings.edges.size()) {
    const std::vector<std::string> shared{daemon_.variable(), cyclonedds_variable()};
    const std::string board = std::to_string(board_.descriptor());
    start("concatenate", as_role("pipeline-concatenate", {board}), shared);
    std::vector<std::string> publishing = shared;
    publishing.push_back("LD_PRELOAD=" + path_of("libagnocast_heaphook.so"));
    for (std::size_t i = 0; i < lidar_count; ++i) {
      start(lidars()[i].name,
            as_role("pipeline-lidar",
                    {board, std::to_string(i), std::to_string(settings.inputs), settings.scan}),
            publishing);
    }
    wait_until_ready();
  }

  Measured conduct(const std::function<void(std::size_t, std::size_t)>& progress) {
    Measured measured;
    measured.times.resize(settings_.edges.size());
    const std::size_t edge_count = settings_.edges.size();
    const std::span<Frame> frames = board_.frames();
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const std::size_t round = i / edge_count;
      const std::size_t place = (i + round) % edge_count;
      carry_out(i, settings_.edges[place], round % settings_.inputs);
      if (round >= settings_.warm_up) measured.times[place].push_back(times_of(frames[i]));
      progress(i + 1, frames.size());
    }
    for (const Output& output : outputs_) {
      measured.top_bytes += output.top_bytes / outputs_.size();
      measured.points += output.points / outputs_.size();
    }
    end();
    return measured;
  }

 private:
  struct Part {
    std::string name;
    Process process;
  };

  void start(const std::string& name, std::vector<std::string> command,
             std::vector<std::string> environment) {
    parts_.push_back({name, Process({.command = std::move(command),
                                     .environment = std::move(environment),
                                     .descriptors = {board_.descriptor()}})});
  }

  void check_processes() {
    if (const std::string error = board_.error(); !error.empty()) throw std::runtime_error(error);
    for (Part& part : parts_) {
      if (const auto status = part.process.status())
        throw std::runtime_error("the process of " + part.name + " ended with status " +
                                 std::to_string(*status));
    }
  }
  /// Returns false when the time is up.
  template <class Attempt>
  bool wait_for(std::int64_t patience_ns, Attempt attempt) {
    const std::uint64_t end_ns = monotonic_ns() + static_cast<std::uint64_t>(patience_ns);
    while (!attempt()) {
      check_processes();
      if (monotonic_ns() > end_ns) return false;
    }
    return true;
  }
  void wait_until_ready() {
    const bool are_ready = wait_for(start_patience_ns, [&] {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      return board_.head().ready == parts_.size();
    });
    if (!are_ready) throw std::runtime_error("its processes do not get ready");
  }

  void carry_out(std::size_t index, std::uint32_t edge, std::size_t input) {
    Frame& frame = board_.frames()[index];
    frame.edge = edge;
    frame.input = static_cast<std::uint32_t>(input);
    frame.released_ns = next_beat();
    board_.head().current = static_cast<std::uint32_t>(index);
    for (sem_t& go : board_.head().go) ::sem_post(&go);
    const std::string name =
        "frame " + std::to_string(index) + " over " + std::string(edges()[edge].name);
    const bool is_done = wait_for(frame_patience_ns, [&] {
      return wait(board_.head().done, 200 * millisecond) && board_.head().has_error == 0;
    });
    if (!is_done) throw std::runtime_error(name + " was lost: " + missing(frame));
    const Output& wanted = outputs_[input];
    if (frame.points != wanted.points || frame.checksum != wanted.checksum)
      throw std::runtime_error(name +
                               " came out changed: " + text_of(frame.points, frame.checksum) +
                               " instead of " + text_of(wanted.points, wanted.checksum));
  }
  static std::string text_of(std::uint64_t points, std::uint64_t checksum) {
    return std::to_string(points) + " points of checksum " + std::to_string(checksum);
  }
  static std::string missing(const Frame& frame) {
    std::string names;
    for (std::size_t i = 0; i < lidar_count; ++i) {
      if (frame.received_ns[i] == 0) names += std::string(" ") + lidars()[i].name;
    }
    return "concatenate did not get the clouds of" + (names.empty() ? " none" : names);
  }

  /// Returns the sensors' next beat, which does not depend on the pipeline.
  std::int64_t next_beat() {
    const std::int64_t soon_ns = static_cast<std::int64_t>(monotonic_ns()) + notice_ns;
    const std::int64_t period_ns = settings_.period.count();
    if (beat_ns_ == 0) {
      beat_ns_ = soon_ns;
    } else {
      beat_ns_ += period_ns;
      while (beat_ns_ < soon_ns) beat_ns_ += period_ns;
    }
    return beat_ns_;
  }

  static FrameTimes times_of(const Frame& frame) {
    const Frame::Chain& top = frame.chains[top_lidar];
    FrameTimes times;
    times.response = static_cast<double>(frame.done_ns - frame.released_ns);
    times.compute = static_cast<double>(top.cpu_ns + frame.cpu_ns);
    times.transfer = static_cast<double>(frame.received_ns[top_lidar] - top.done_ns);
    times.wait = times.response - times.compute - times.transfer;
    return times;
  }

  void end() {
    board_.head().is_over = 1;
    for (sem_t& go : board_.head().go) ::sem_post(&go);
    ::sem_post(&board_.head().over);
    for (Part& part : parts_) {
      const auto status = part.process.wait(std::chrono::seconds(20));
      if (!status) throw std::runtime_error("the process of " + part.name + " does not end");
      if (*status != 0)
        throw std::runtime_error("the process of " + part.name + " ended with status " +
                                 std::to_string(*status) + ": " + board_.error());
    }
  }

  const Settings& settings_;
  const std::vector<Output> outputs_;
  Daemon daemon_;
  Board board_;
  std::vector<Part> parts_;  // ended before the objects that they use
  std::int64_t beat_ns_ = 0;
};

}  // namespace

Measured run(const Settings& settings,
             const std::function<void(std::size_t, std::size_t)>& progress) {
  Conductor conductor(settings);
  return conductor.conduct(progress);
}

}  // namespace agnocast::bench::pipeline
