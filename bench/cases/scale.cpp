// SPDX-License-Identifier: Apache-2.0
//
// scale: the cost of larger numbers. Subscriptions and publishers of one topic up to 128 (each in
// a process of its own, and all in one), topics up to 4,000, processes up to 1,000. A scene is a
// daemon, one process that publishes, one that joins and leaves, and a crowd (scale_crowd.hpp)
// that grows from point to point; each point has the same measurements:
//
//   publish             the publish call, all receivers asleep: its median, and its mean, because
//                       one call of eight scans all links
//   wake                from before that call to the callback of the last subscription
//   subscription        the create_subscription call, and the first message in its callback since
//                       before that call
//   publisher           the create_publisher call, and its first message everywhere since before
//                       that call
//   daemon              resident memory, shared part (tables, board, regions), processor time per
//                       joined process
//
// It prints the points, and the slope of each by least squares. A curve ends early, with a
// sentence, when memory, a limit or its time is exhausted. Any other error makes the case fail.

#include <bench/case.hpp>
#include <bench/cases/looking.hpp>
#include <bench/cases/scale_crowd.hpp>
#include <bench/figures.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>

#include <array>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

namespace agnocast::bench {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::seconds;

// Heaps of a few pages each, because nothing here is large; and more topics than one user has by
// default.
constexpr std::string_view config =
    "[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"64MiB\"\n[quota]\ntopics = 4096\n";
constexpr const char* topic = "/scale/probe";
// Memory kept free for everything else on the machine.
constexpr std::size_t spare_bytes = std::size_t{2} << 30;

/// Ends the curve here, with the reason.
struct Stop : std::runtime_error {
  using std::runtime_error::runtime_error;
};

struct Metric {
  const char* key;
  const char* head;   // of its column
  const char* title;  // in a sentence or a legend
  const char* plot;   // metrics with the same name share a plot
  double unit;        // divisor for printing
  const char* unit_name;
};
constexpr std::array<Metric, 10> metrics{{
    {"publish_p50_ns", "publish", "publish call", "deliveries", 1e3, "µs"},
    {"publish_mean_ns", "its mean", "publish call, mean", "deliveries", 1e3, "µs"},
    {"wake_p50_ns", "wake last", "wake of the last", "deliveries", 1e3, "µs"},
    {"join_subscription_p50_ns", "subscription", "create_subscription", "joins", 1e3, "µs"},
    {"first_message_p50_ns", "its first", "its first message", "joins", 1e3, "µs"},
    {"join_publisher_p50_ns", "publisher", "create_publisher", "joins", 1e3, "µs"},
    {"first_publication_p50_ns", "its first", "its first publication", "joins", 1e3, "µs"},
    {"daemon_resident_bytes", "resident", "resident", "daemon-memory", 1 << 20, "MiB"},
    {"daemon_shared_bytes", "of it shared", "of it shared", "daemon-memory", 1 << 20, "MiB"},
    {"daemon_cpu_ns_per_join", "daemon CPU", "daemon's CPU at the join", "daemon-cpu", 1e3, "µs"},
}};

struct Effort {
  std::size_t messages, joins;
  seconds curve;  // a curve takes at most this and one step
};

class Scene {
 public:
  explicit Scene(seconds budget) : end_(Clock::now() + budget) {
    sender_ = start();
    joiner_ = start();
    receiver_ = start();
    ask(*sender_, command("advertise", topic, 1));
    ask(*receiver_, command("subscribe", topic, 1, 0));
    receivers_ = 1;
  }

  /// Functions that enlarge the crowd of a curve.
  void add_subscription_in_its_own_process() {
    crowd_.push_back(start());
    ask(*crowd_.back(), command("subscribe", topic, 1, receivers_++));
  }
  void add_subscriptions_beside_the_first(std::size_t count) {
    ask(*receiver_, command("subscribe", topic, count, receivers_));
    receivers_ += count;
  }
  void add_publisher_in_its_own_process() {
    crowd_.push_back(start());
    ask(*crowd_.back(), command("advertise", topic, 1));
  }
  void add_publishers_beside_the_first(std::size_t count) {
    ask(*sender_, command("advertise", topic, count));
  }
  void add_pair_in_its_own_process(std::size_t number) {
    crowd_.push_back(start());
    ask(*crowd_.back(), command("pairs", "/scale/pair_", number, 1));
  }
  /// Adds pairs on topics of their own, alternating between so many processes.
  void add_pairs(std::size_t first, std::size_t count, std::size_t processes) {
    while (crowd_.size() < processes) crowd_.push_back(start());
    const std::size_t share = (count + processes - 1) / processes;
    for (std::size_t done = 0, i = 0; done < count; done += share, ++i)
      ask(*crowd_[i],
          command("pairs", "/scale/pair_", first + done, std::min(share, count - done)));
  }

  struct Point {
    std::map<std::string, double> of;  // by the key of the metric
    std::size_t messages = 0, joins = 0;
  };
  Point measure(const Effort& effort) {
    Point point;
    // Returns the number of samples.
    const auto take = [&](Process& who, const std::string& what, const char* call,
                          const char* arrival) {
      const std::vector<double> times = ask(who, what);
      std::vector<double> calls, arrivals;
      for (std::size_t i = 0; i + 1 < times.size(); i += 2)
        calls.push_back(times[i]), arrivals.push_back(times[i + 1]);
      const std::size_t count = calls.size();
      if (call == std::string_view("publish_p50_ns")) point.of["publish_mean_ns"] = mean(calls);
      point.of[call] = median(std::move(calls));
      point.of[arrival] = median(std::move(arrivals));
      return count;
    };
    constexpr std::size_t warm_up = 5;
    (void)ask(*sender_, command("send", topic, warm_up, receivers_, numbers(warm_up)));
    (void)ask(*joiner_, command("join", topic, 1));
    (void)ask(*joiner_, command("speak", topic, 1, receivers_, numbers(1)));
    (void)ask(*sender_, command("send", topic, 1, receivers_, numbers(1)));
    point.messages = take(
        *sender_, command("send", topic, effort.messages, receivers_, numbers(effort.messages)),
        "publish_p50_ns", "wake_p50_ns");
    point.joins = take(*joiner_, command("join", topic, effort.joins), "join_subscription_p50_ns",
                       "first_message_p50_ns");
    point.joins +=
        take(*joiner_, command("speak", topic, effort.joins, receivers_, numbers(effort.joins)),
             "join_publisher_p50_ns", "first_publication_p50_ns");
    // Publishes a message of the remaining publisher: later ones join and leave, and would find
    // nothing.
    ask(*sender_, command("send", topic, 1, receivers_, numbers(1)));
    const pid_t worker = worker_of(daemon_);
    point.of["daemon_resident_bytes"] = static_cast<double>(resident_bytes(worker));
    point.of["daemon_shared_bytes"] = static_cast<double>(shared_bytes(worker));
    return point;
  }

  double daemon_cpu_ns() { return cpu_ns_of(worker_of(daemon_)); }

 private:
  template <typename... Words>
  static std::string command(Words... words) {
    std::ostringstream line;
    ((line << words << ' '), ...);
    return line.str();
  }
  /// Returns the first of `count` unused numbers.
  std::uint64_t numbers(std::size_t count) { return std::exchange(number_, number_ + count); }

  std::unique_ptr<Process> start() {
    if (Clock::now() > end_) throw Stop("its time is up");
    if (available_bytes() < spare_bytes)
      throw Stop("the machine's memory is used up but for 2 GiB");
    try {
      return std::make_unique<Process>(Process::Options{
          .command = as_role("scale-crowd", {std::to_string(arrivals_.descriptor())}),
          .environment = variables_of(daemon_),
          .descriptors = {arrivals_.descriptor()},
          .has_pipes = true});
    } catch (const std::system_error& error) {
      if (!is_limit(error.code().value())) throw;
      throw Stop(error.what());
    }
  }
  std::vector<double> ask(Process& who, const std::string& what) {
    if (!who.send(what)) throw std::runtime_error("a process of the crowd has ended");
    std::istringstream answer(who.line());
    std::string word;
    answer >> word;
    if (word != "ok") {
      std::string why;
      std::getline(answer >> std::ws, why);
      if (word == "no") throw Stop(why);
      throw std::runtime_error(why);
    }
    std::vector<double> times;
    for (double ns = 0; answer >> ns;) times.push_back(ns);
    return times;
  }

  Clock::time_point end_;
  Daemon daemon_{config};
  Arrivals arrivals_;
  std::unique_ptr<Process> sender_, joiner_, receiver_;
  std::deque<std::unique_ptr<Process>> crowd_;
  std::size_t receivers_ = 0;
  std::uint64_t number_ = 1;
};

struct Curve {
  const char* axis;       // the growing quantity
  const char* placement;  // their processes
  std::vector<std::size_t> counts;
  void (*grow)(Scene&, std::size_t from, std::size_t to);
  std::size_t first;  // size of a new scene
};

const std::vector<std::size_t> doubling{1, 2, 4, 8, 16, 32, 64, 128};

std::vector<Curve> curves() {
  return {
      {"subscribers", "each in its process", doubling,
       [](Scene& scene, std::size_t from, std::size_t to) {
         for (; from < to; ++from) scene.add_subscription_in_its_own_process();
       },
       1},
      {"subscribers", "all in one process", doubling,
       [](Scene& scene, std::size_t from, std::size_t to) {
         if (from < to) scene.add_subscriptions_beside_the_first(to - from);
       },
       1},
      {"publishers", "each in its process", doubling,
       [](Scene& scene, std::size_t from, std::size_t to) {
         for (; from < to; ++from) scene.add_publisher_in_its_own_process();
       },
       1},
      {"publishers", "all in one process", doubling,
       [](Scene& scene, std::size_t from, std::size_t to) {
         if (from < to) scene.add_publishers_beside_the_first(to - from);
       },
       1},
      {"topics",
       "in eight processes",
       {1, 250, 500, 1000, 2000, 3000, 4000},
       [](Scene& scene, std::size_t from, std::size_t to) {
         if (from < to) scene.add_pairs(from, to - from, 8);
       },
       1},
      {"processes",
       "a pair and a topic each",
       {3, 50, 100, 200, 400, 700, 1000},
       [](Scene& scene, std::size_t from, std::size_t to) {
         for (; from < to; ++from) scene.add_pair_in_its_own_process(from);
       },
       3},
  };
}

// Explanation of the slopes, from the design (docs/protocol.md, docs/control-plane.md).
constexpr std::pair<const char*, const char*> made_of[] = {
    {"subscribers",
     "The publish call reads the sleep word of each process, and with small messages in one call "
     "of eight (the deferred scan)\n"
     "  each subscription's link and hold bits: that is in the mean, hardly in the median. It "
     "rings "
     "two sleeping processes itself,\n"
     "  by a system call each, and leaves the others to the control thread, whose work is in the "
     "last wake. That adds the\n"
     "  processes' time on the cores, or the callbacks before it in the one thread. The daemon "
     "announces a joining publisher\n"
     "  to each process, which maps it before the message arrives."},
    {"publishers",
     "The publish call does not know other publishers. A waking process checks the queue of "
     "each publisher before it\n"
     "  sleeps again. The daemon announces every publisher to a joining subscription, which links "
     "each; if it is of another\n"
     "  process, it first maps region and heap."},
    {"topics",
     "Neither the data path nor a join reads other topics: the rest is a cache effect. The "
     "daemon's pages are those of\n"
     "  the topic in the board, of the publisher's extent, where it writes the first head, and its "
     "own records; each joined\n"
     "  one is a topic with a publisher and a subscription."},
    {"processes",
     "Neither the data path nor a join reads processes that share no topic. The daemon keeps a "
     "connection, a region, a\n"
     "  heap window and two doorbells for each; each joined one is a process with a publisher and "
     "a "
     "subscription on a topic\n"
     "  of its own, whose pages (above) are most of its memory."},
};

class Scale {
 public:
  Scale(const Run& run, Report& report) : run_(run), report_(report) {
    effort_.messages = run.messages.value_or(run.is_small ? 5 : 100);
    effort_.joins = run.rounds.value_or(run.is_small ? 2 : 15);
    effort_.curve = seconds(run.is_small ? 20 : 45);
  }

  void run_all() {
    std::vector<Curve> all = curves();
    for (Curve& curve : all) {
      if (!run_.is_small) continue;
      curve.counts.resize(3);
      if (curve.counts.back() > 10) curve.counts = {curve.first, curve.first + 8, curve.first + 16};
    }
    std::size_t steps = 0;
    for (const Curve& curve : all) steps += curve.counts.size();
    for (std::size_t i = 0; i < all.size(); ++i) {
      measure(all[i], steps);
      const bool is_last_of_axis =
          i + 1 == all.size() || all[i].axis != std::string_view(all[i + 1].axis);
      if (!is_last_of_axis) continue;
      if (i > 0 && all[i - 1].axis == std::string_view(all[i].axis))
        say_difference(all[i - 1], all[i]);
      for (const auto& [axis, sentence] : made_of) {
        if (axis == std::string_view(all[i].axis)) report_.say(std::string("  ") + sentence);
      }
    }
    report_.progress(steps, steps, "");
    for (auto& [name, plot] : plots_) report_.add(std::move(plot));
  }

 private:
  void measure(const Curve& curve, std::size_t steps) {
    say_head(curve);
    std::map<std::string, std::vector<double>> x, y;
    std::string why_early;
    try {
      Scene scene(effort_.curve);
      std::size_t have = curve.first;
      for (const std::size_t count : curve.counts) {
        report_.progress(step_++, steps, std::string(curve.axis) + " " + std::to_string(count));
        const double cpu = scene.daemon_cpu_ns();
        curve.grow(scene, have, count);
        const double spent = scene.daemon_cpu_ns() - cpu;
        auto point = scene.measure(effort_);
        if (count > have)
          point.of["daemon_cpu_ns_per_join"] = spent / static_cast<double>(count - have);
        have = count;
        add_point(curve, count, point);
        for (const auto& [key, value] : point.of)
          x[key].push_back(static_cast<double>(count)), y[key].push_back(value);
      }
    } catch (const Stop& stop) {
      // A limit is a result; a small run must not meet any.
      if (run_.is_small) throw;
      why_early = stop.what();
      report_.say("  ends early: " + why_early);
    }
    finish(curve, x, y, why_early);
  }

  void say_head(const Curve& curve) {
    report_.say(text("\n%s, %s: medians of %zu messages and %zu joins", curve.axis, curve.placement,
                     effort_.messages, effort_.joins));
    std::string head = text("%10s", "");
    std::string units = text("%10s", "");
    for (const Metric& metric : metrics) {
      head += text(" %13s", metric.head);
      // The micro sign has two bytes.
      units += text(metric.unit_name[0] == 'M' ? " %13s" : " %14s", metric.unit_name);
    }
    report_.say(head);
    report_.say(units);
  }

  void add_point(const Curve& curve, std::size_t count, const Scene::Point& point) {
    nlohmann::json result{{"system", "agnocast-executor"}, {"part", curve.axis},
                          {"placement", curve.placement},  {"count", count},
                          {"samples", point.messages},     {"joins", point.joins}};
    std::string row = text("%10zu", count);
    for (const Metric& metric : metrics) {
      const auto found = point.of.find(metric.key);
      row += found == point.of.end() ? text(" %13s", "")
                                     : text(" %13.1f", found->second / metric.unit);
      if (found != point.of.end()) result[metric.key] = found->second;
    }
    report_.say(row);
    report_.add(std::move(result));
  }

  void finish(const Curve& curve, std::map<std::string, std::vector<double>>& x,
              std::map<std::string, std::vector<double>>& y, const std::string& why_early) {
    std::string row = text("%10s", "each more");
    nlohmann::json slopes = nlohmann::json::object();
    for (const Metric& metric : metrics) {
      const std::vector<double>& values = y[metric.key];
      const Line line = line_through(x[metric.key], values);
      row += text(" %13.3f", line.slope / metric.unit);
      if (values.size() < 2) continue;
      slopes_[curve.placement][metric.key] = line.slope;
      slopes[metric.key] = {{"slope", line.slope}, {"offset", line.offset}};
      std::vector<double> shown;
      for (const double value : values) shown.push_back(value / metric.unit);
      plot_of(curve, metric)
          .series.push_back({{"label", text("%s, %s", metric.title, curve.placement)},
                             {"x", x[metric.key]},
                             {"y", shown}});
    }
    report_.say(row);
    nlohmann::json result{{"system", "agnocast-executor"},
                          {"part", curve.axis},
                          {"placement", curve.placement},
                          {"points", x[metrics.front().key].size()},
                          {"slopes", slopes}};
    if (!why_early.empty()) result["ended_early"] = why_early;
    report_.add(std::move(result));
  }
  /// Prints the additional cost of a process of its own for each of them.
  void say_difference(const Curve& own, const Curve& one) {
    std::string line = "  a process of its own costs each, µs more:";
    const char* comma = " ";
    for (const Metric& metric : metrics) {
      if (metric.unit != 1e3) continue;
      const double more = slopes_[own.placement][metric.key] - slopes_[one.placement][metric.key];
      line += text("%s%s %.2f", comma, metric.title, more / metric.unit);
      comma = ", ";
    }
    report_.say(line);
    slopes_.clear();
  }
  Plot& plot_of(const Curve& curve, const Metric& metric) {
    const std::string name = text("scale-%s-%s", curve.axis, metric.plot);
    const auto [place, is_new] = plots_.try_emplace(name);
    if (is_new) {
      place->second.name = name;
      place->second.kind = "lines";
      place->second.title = text("More %s: %s", curve.axis, metric.plot);
      place->second.x_label = curve.axis;
      place->second.y_label = metric.unit_name;
    }
    return place->second;
  }

  const Run& run_;
  Report& report_;
  Effort effort_{};
  std::size_t step_ = 0;
  std::map<std::string, Plot> plots_;
  std::map<std::string, std::map<std::string, double>> slopes_;  // by placement and metric
};

}  // namespace

void run_scale(const Run& run, Report& report) { Scale(run, report).run_all(); }

}  // namespace agnocast::bench
