// SPDX-License-Identifier: Apache-2.0

#include <tests/system/soak_client.hpp>

#include <tests/system/soak_traffic.hpp>

namespace agnocast::test {
namespace {

// --- mayflies ---

class Mayfly {
 public:
  Mayfly(Here here, std::uint64_t seed)
      : here_(here), random_(seed), node_("mayfly"), assigned_(random_.chance(50)) {
    if (assigned_) {
      executor_.emplace().add_node(node_);
    } else {
      background_.emplace().add_node(node_);
    }
  }

  void live() {
    for (std::uint64_t i = 0, count = 1 + random_.below(4); i < count; ++i) join();
    for (;;) {
      ++here_.place.looks;
      for (auto& writer : writers_) {
        for (std::uint64_t i = 0, count = random_.below(3); i < count; ++i) writer->publish();
        if (random_.chance(2)) writer->take_room(random_.below(40) << 20);
      }
      for (auto& reader : readers_) reader->tend(8);
      if (executor_) executor_->spin_some();
      if (random_.chance(3)) leave();
      if (random_.chance(3) && writers_.size() + readers_.size() < 6) join();
      if (random_.below(1000) < 4) end_properly();
      release_ended(now_ns());
      ::usleep(static_cast<useconds_t>(random_.below(2000)));
    }
  }

 private:
  void join() {
    const auto topic =
        static_cast<SoakTopic>(random_.below(static_cast<std::uint64_t>(SoakTopic::count)));
    if (random_.chance(50)) {
      if (auto writer = Writer::make(here_, node_, topic, random_))
        writers_.push_back(std::move(writer));
      return;
    }
    constexpr Reader::Kind kinds[] = {Reader::Kind::take, Reader::Kind::take,
                                      Reader::Kind::callback, Reader::Kind::callback,
                                      Reader::Kind::newest};
    const Reader::Kind kind = kinds[random_.below(std::size(kinds))];
    if (auto reader = Reader::make(here_, node_, topic, kind, subscription_qos(topic, random_),
                                   random_.next()))
      readers_.push_back(std::move(reader));
  }
  void leave() {
    if (random_.chance(50) && !writers_.empty()) {
      writers_.erase(writers_.begin() +
                     static_cast<std::ptrdiff_t>(random_.below(writers_.size())));
    } else if (!readers_.empty()) {
      const auto leaving =
          readers_.begin() + static_cast<std::ptrdiff_t>(random_.below(readers_.size()));
      for (Held& held : (*leaving)->end()) outliving_.push_back(std::move(held));
      readers_.erase(leaving);
    }
  }
  void release_ended(std::uint64_t now) {
    while (!outliving_.empty() && outliving_.front().until_ns <= now) {
      verify(here_, outliving_.front(), "release after its subscription");
      outliving_.pop_front();
      ++here_.board.released;
    }
  }
  [[noreturn]] void end_properly() {
    if (random_.chance(70)) {
      while (!readers_.empty() || !writers_.empty()) leave();
      release_ended(~std::uint64_t{0});
    }
    ::_exit(0);
  }

  Here here_;
  Random random_;
  Node node_;
  const bool assigned_;
  std::optional<SingleThreadedExecutor> executor_;
  std::optional<BackgroundExecutor> background_;
  std::vector<std::unique_ptr<Writer>> writers_;
  std::vector<std::unique_ptr<Reader>> readers_;
  std::deque<Held> outliving_;
};

// --- residents ---

class Resident {
 public:
  Resident(Here here, std::uint64_t seed) : here_(here), random_(seed), node_("resident") {
    executor_.add_node(node_);
  }

  void live() {
    for (std::uint64_t i = 0; i < static_cast<std::uint64_t>(SoakTopic::count); ++i) {
      const auto topic = static_cast<SoakTopic>(i);
      // Receives the messages of all publishers there.
      const QoS qos =
          topic == SoakTopic::mixed ? QoS(10).best_effort() : subscription_qos(topic, random_);
      const auto kind = random_.chance(50) ? Reader::Kind::take : Reader::Kind::callback;
      if (auto reader = Reader::make(here_, node_, topic, kind, qos, random_.next()))
        readers_.push_back(std::move(reader));
    }
    go_on_until(SoakBoard::run);
    for (std::uint64_t i = 0; i < static_cast<std::uint64_t>(SoakTopic::count); ++i) {
      if (auto writer = Writer::make(here_, node_, static_cast<SoakTopic>(i), random_))
        writers_.push_back(std::move(writer));
    }
    for (auto& writer : writers_) writer->take_room(20 << 20);
    is_writing_ = true;
    go_on_until(SoakBoard::silence);
    is_writing_ = false;
    go_on_until(SoakBoard::drain);
    account();
    go_on_until(SoakBoard::unsubscribe);
    for (auto& reader : readers_) {
      for (const Held& held : reader->end()) verify(here_, held, "release in the end");
    }
    readers_.clear();
    go_on_until(SoakBoard::unpublish);
    writers_.clear();
    expect_empty_heap();
    go_on_until(SoakBoard::end);
  }

 private:
  void go_on_until(SoakBoard::Phase phase) {
    here_.place.waits_for = phase;
    while (here_.board.phase < phase) step();
  }
  void step() {
    ++here_.place.looks;
    for (auto& reader : readers_) reader->tend(64);
    if (is_writing_) {
      for (auto& writer : writers_) {
        if (random_.chance(30)) writer->publish();
      }
    }
    ::usleep(static_cast<useconds_t>(500 + random_.below(2000)));
  }

  // Checks that every committed message was taken or counted as lost, and nothing else was.
  void account() {
    std::array<std::uint64_t, static_cast<std::size_t>(SoakTopic::count)> committed{}, attempted{};
    const std::uint64_t count =
        std::min<std::uint64_t>(here_.board.publisher_count, SoakBoard::publisher_count_max);
    for (std::uint64_t i = 0; i < count; ++i) {
      const PublisherRecord& record = here_.board.publisher[i];
      if (record.topic == 0) continue;  // killed before it had asked
      committed[record.topic - 1] += record.committed;
      attempted[record.topic - 1] += record.attempted;
    }
    for (auto& reader : readers_) {
      const auto topic = static_cast<std::size_t>(reader->topic());
      const std::uint64_t end = now_ns() + patience_ns;
      while (reader->accounted() < committed[topic] && now_ns() < end) step();
      const std::uint64_t accounted = reader->accounted();
      if (accounted < committed[topic] || accounted > attempted[topic])
        here_.board.complain(
            "%s: %llu committed (%llu attempted), but %llu taken or counted as lost",
            name_of(reader->topic()).c_str(), static_cast<unsigned long long>(committed[topic]),
            static_cast<unsigned long long>(attempted[topic]),
            static_cast<unsigned long long>(accounted));
      if (accounted < committed[topic]) reader->complain_of_missing();
    }
  }

  void expect_empty_heap() {
    // Blocks in the caches of this process's threads count as live.
    constexpr std::uint64_t cached_bytes_max = 64 << 10;
    agnocast_heaphook_usage usage{};
    for (const std::uint64_t end = now_ns() + patience_ns; now_ns() < end; step()) {
      agnocast_heaphook()->usage(&usage);
      if (Parcel::alive == 0 && usage.live_bytes <= cached_bytes_max) return;
    }
    here_.board.complain("%llu messages and %llu bytes of the heap are still there",
                         static_cast<unsigned long long>(Parcel::alive.load()),
                         static_cast<unsigned long long>(usage.live_bytes));
  }

  Here here_;
  Random random_;
  Node node_;
  BackgroundExecutor executor_;
  std::vector<std::unique_ptr<Reader>> readers_;
  std::vector<std::unique_ptr<Writer>> writers_;
  bool is_writing_ = false;
};

// A fault is a wrong byte too: reports the address, and its mapping. Not safe in a signal handler,
// but the process is over anyway.
SoakBoard* board_of_faults = nullptr;
SoakPlace* place_of_faults = nullptr;

void on_fault(int signal, siginfo_t* info, void*) {
  const auto address = reinterpret_cast<std::uint64_t>(info->si_addr);
  unsigned long long begin = 0, end = 0;
  char line[256] = "", rights[8] = "", path[128] = "";
  std::FILE* const maps = std::fopen("/proc/self/maps", "re");
  while (std::fgets(line, sizeof line, maps) != nullptr) {
    path[0] = '\0';
    (void)std::sscanf(line, "%llx-%llx %7s %*s %*s %*s %127s", &begin, &end, rights, path);
    if (address >= begin && address < end) break;
    begin = end = 0;
  }
  board_of_faults->complain(
      "place %td: signal %d at %#llx, which lies in %llx-%llx %s %s; reading number %llu of token "
      "%#llx",
      place_of_faults - board_of_faults->place, signal, static_cast<unsigned long long>(address),
      begin, end, rights, path,
      static_cast<unsigned long long>(place_of_faults->reading_number.load()),
      static_cast<unsigned long long>(place_of_faults->reading_token.load()));
  ::_exit(1);
}

template <class Life>
[[noreturn]] void run(SoakBoard& board, SoakPlace& place, std::uint64_t seed) {
  board_of_faults = &board;
  place_of_faults = &place;
  struct sigaction action {};
  action.sa_sigaction = on_fault;
  action.sa_flags = SA_SIGINFO;
  for (const int signal : {SIGSEGV, SIGBUS, SIGABRT}) ::sigaction(signal, &action, nullptr);
  crash_points::use(place.control);
  try {
    auto* const life = new Life(Here{board, place}, seed);  // never destroyed: it ends like this
    life->live();
  } catch (const std::exception& error) {
    board.complain("thrown: %s", error.what());
  }
  ::_exit(0);
}

}  // namespace

void run_mayfly(SoakBoard& board, SoakPlace& place, std::uint64_t seed) {
  run<Mayfly>(board, place, seed);
}
void run_resident(SoakBoard& board, SoakPlace& place, std::uint64_t seed) {
  run<Resident>(board, place, seed);
}

}  // namespace agnocast::test
