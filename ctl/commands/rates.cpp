// SPDX-License-Identifier: Apache-2.0
//
// topic hz, topic bw: from the counters of the publishers and the stamps of their queues. Without
// a subscription they cost the publisher nothing and work for any type at any rate.
//
// Every 10 ms a look collects the stamps of the messages committed since the last look, as far
// back as the queue still has them; the older ones are spread evenly over their interval. So the
// mean is exact, and minimum, maximum and deviation are exact as long as fewer messages come
// between two looks than the queue has slots.

#include <base/clock.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/waiting.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/watch.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <deque>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::ctl {
namespace {

constexpr int look_ms = 10;
constexpr int report_ms = 1000;
// Counters are read without a request; publishers change only when programs start and end.
constexpr int renew_ms = 250;
constexpr std::size_t window_stamps_max = 64;

/// One message, or one of several that came too fast to be told apart.
struct Arrival {
  std::uint64_t stamp_ns = 0;
  std::uint64_t bytes = 0;
};

/// The messages of one topic, of all publishers together.
class Stream {
 public:
  explicit Stream(std::size_t window) : window_(window) {}

  void look(const System& system, const Topic& topic) {
    std::vector<Arrival> news;
    for (const Endpoint& publisher : topic.publishers) {
      const auto numbers = counters_of_publisher(system, topic, publisher);
      if (!numbers) continue;
      const RecentStamps recent = recent_stamps(system, publisher, window_stamps_max);
      auto [known, is_new] = seen_.try_emplace(publisher.facts.generation);
      Seen& seen = known->second;
      if (is_new) {
        seen = {recent.newest, recent.stamps_ns.empty() ? 0 : recent.stamps_ns.back(),
                numbers->published_bytes};
        continue;
      }
      if (recent.newest <= seen.count || recent.stamps_ns.empty()) continue;
      add(seen, recent, numbers->published_bytes - std::min(seen.bytes, numbers->published_bytes),
          news);
      seen = {recent.newest, recent.stamps_ns.back(), numbers->published_bytes};
    }
    std::sort(news.begin(), news.end(),
              [](const Arrival& a, const Arrival& b) { return a.stamp_ns < b.stamp_ns; });
    for (const Arrival& arrival : news) {
      arrivals_.push_back(arrival);
      if (arrivals_.size() > window_) arrivals_.pop_front();
    }
    total_ += news.size();
  }

  const std::deque<Arrival>& arrivals() const noexcept { return arrivals_; }
  std::uint64_t total() const noexcept { return total_; }

 private:
  struct Seen {
    std::uint64_t count = 0, stamp_ns = 0, bytes = 0;
  };

  static void add(const Seen& seen, const RecentStamps& recent, std::uint64_t bytes,
                  std::vector<Arrival>& news) {
    const std::uint64_t came = recent.newest - seen.count;
    const std::uint64_t each = bytes / came;
    const std::uint64_t known = std::min<std::uint64_t>(came, recent.stamps_ns.size());
    const std::uint64_t first_known = recent.stamps_ns[recent.stamps_ns.size() - known];
    const std::uint64_t lost = came - known;
    // Before a publisher's first messages there is no stamp.
    const std::uint64_t from = seen.stamp_ns == 0 ? first_known : seen.stamp_ns;
    for (std::uint64_t i = 1; i <= lost; ++i)
      news.push_back({from + (first_known - std::min(from, first_known)) * i / (lost + 1), each});
    for (std::uint64_t i = 0; i < known; ++i)
      news.push_back({recent.stamps_ns[recent.stamps_ns.size() - known + i], each});
  }

  std::size_t window_;
  std::map<std::uint64_t, Seen> seen_;  // by generation of the publisher
  std::deque<Arrival> arrivals_;
  std::uint64_t total_ = 0;
};

struct Statistics {
  std::size_t count = 0;  // of gaps
  double mean = 0, least = 0, most = 0, deviation = 0;
};

Statistics statistics_of(const std::vector<double>& values) {
  Statistics all;
  all.count = values.size();
  if (values.empty()) return all;
  double sum = 0, squares = 0;
  for (const double value : values) sum += value;
  all.mean = sum / static_cast<double>(values.size());
  for (const double value : values) squares += (value - all.mean) * (value - all.mean);
  all.deviation = std::sqrt(squares / static_cast<double>(values.size()));
  const auto [least, most] = std::minmax_element(values.begin(), values.end());
  all.least = *least;
  all.most = *most;
  return all;
}

/// Returns the statistics of the gaps between messages, in seconds.
Statistics gaps_of(const Stream& stream) {
  std::vector<double> gaps;
  for (std::size_t i = 1; i < stream.arrivals().size(); ++i)
    gaps.push_back(
        static_cast<double>(stream.arrivals()[i].stamp_ns - stream.arrivals()[i - 1].stamp_ns) *
        1e-9);
  return statistics_of(gaps);
}
Statistics sizes_of(const Stream& stream) {
  std::vector<double> sizes;
  for (const Arrival& arrival : stream.arrivals())
    sizes.push_back(static_cast<double>(arrival.bytes));
  return statistics_of(sizes);
}

std::string fixed(double value, int places) {
  char text[64];
  std::snprintf(text, sizeof text, "%.*f", places, value);
  return text;
}

/// Formats bytes with decimal units, as ros2, links and disks do.
std::string decimal_bytes(double bytes) {
  constexpr const char* units[] = {"B", "KB", "MB", "GB", "TB"};
  std::size_t unit = 0;
  for (; bytes >= 1000 && unit + 1 < std::size(units); ++unit) bytes /= 1000;
  return fixed(bytes, 2) + ' ' + units[unit];
}

struct Named {
  std::string name;
  Stream stream;
};

void print_hz(const std::vector<Named>& topics, Console& console) {
  if (topics.size() == 1) {
    const Statistics gaps = gaps_of(topics.front().stream);
    if (gaps.count == 0 || gaps.mean == 0) return;
    console.line("average rate: " + fixed(1 / gaps.mean, 3) + "\n\tmin: " + fixed(gaps.least, 3) +
                 "s max: " + fixed(gaps.most, 3) + "s std dev: " + fixed(gaps.deviation, 5) +
                 "s window: " + std::to_string(gaps.count + 1));
    return;
  }
  Table table({"topic", "rate", "min_delta", "max_delta", "stddev", "window"});
  for (const Named& topic : topics) {
    const Statistics gaps = gaps_of(topic.stream);
    if (gaps.count == 0 || gaps.mean == 0) continue;
    table.add({escaped(topic.name), fixed(1 / gaps.mean, 3), fixed(gaps.least, 3),
               fixed(gaps.most, 3), fixed(gaps.deviation, 5), std::to_string(gaps.count + 1)});
  }
  table.print(console);
  console.line("");
}

void print_bw(const std::vector<Named>& topics, Console& console) {
  Table table({"topic", "bandwidth", "messages", "mean", "min", "max"});
  for (const Named& topic : topics) {
    const Statistics gaps = gaps_of(topic.stream), sizes = sizes_of(topic.stream);
    if (gaps.count == 0 || gaps.mean == 0) continue;
    const std::string bandwidth = decimal_bytes(sizes.mean / gaps.mean) + "/s";
    const std::string count = std::to_string(topic.stream.arrivals().size());
    const std::string mean = decimal_bytes(sizes.mean), least = decimal_bytes(sizes.least),
                      most = decimal_bytes(sizes.most);
    if (topics.size() == 1)
      return console.line(bandwidth + " from " + count + " messages\n\tMessage size mean: " + mean +
                          " min: " + least + " max: " + most);
    table.add({escaped(topic.name), bandwidth, count, mean, least, most});
  }
  if (topics.size() == 1) return;
  table.print(console);
  console.line("");
}

Object object_of(const std::vector<Named>& topics, const char* schema) {
  Object list = Object::array();
  const auto nanoseconds = [](double seconds) {
    return static_cast<std::uint64_t>(std::llround(seconds * 1e9));
  };
  const auto whole = [](double value) { return static_cast<std::uint64_t>(std::llround(value)); };
  for (const Named& topic : topics) {
    const Statistics gaps = gaps_of(topic.stream), sizes = sizes_of(topic.stream);
    const bool known = gaps.count != 0 && gaps.mean > 0;
    list.push_back(
        {{"name", topic.name},
         {"messages", topic.stream.total()},
         {"window", topic.stream.arrivals().size()},
         {"rate_hz", known ? Object(1 / gaps.mean) : Object(nullptr)},
         {"gap_min_ns", known ? Object(nanoseconds(gaps.least)) : Object(nullptr)},
         {"gap_max_ns", known ? Object(nanoseconds(gaps.most)) : Object(nullptr)},
         {"gap_deviation_ns", known ? Object(nanoseconds(gaps.deviation)) : Object(nullptr)},
         {"bytes_per_second", known ? Object(whole(sizes.mean / gaps.mean)) : Object(nullptr)},
         {"message_mean_bytes", known ? Object(whole(sizes.mean)) : Object(nullptr)},
         {"message_min_bytes", known ? Object(whole(sizes.least)) : Object(nullptr)},
         {"message_max_bytes", known ? Object(whole(sizes.most)) : Object(nullptr)}});
  }
  return {{"schema", schema}, {"topics", list}};
}

enum class What : std::uint8_t { rate, bandwidth };

Outcome<void> measure(const Arguments& arguments, Console& console, What what) {
  const Waiting waiting;
  auto watch = Watch::begin(arguments.socket);
  if (!watch) return tl::unexpected(watch.error());
  std::vector<Named> topics;
  for (const std::string& name : arguments.subjects) {
    const auto topic = find_topic(watch->system(), arguments, name);
    if (!topic) return tl::unexpected(topic.error());
    topics.push_back(
        {(*topic)->name, Stream(arguments.whole(what == What::rate ? options::window
                                                                   : options::bandwidth_window))});
  }
  const std::uint64_t reports = arguments.whole(options::reports);
  std::uint64_t next_report = monotonic_ms() + report_ms, next_renewal = monotonic_ms() + renew_ms;
  for (std::uint64_t reported = 0; reports == 0 || reported < reports;) {
    for (Named& named : topics) {
      for (const auto& [index, topic] : watch->system().topics) {
        if (topic.name == named.name && topic.facts.domain == arguments.domain)
          named.stream.look(watch->system(), topic);
      }
    }
    if (!waiting.sleep_ms(look_ms)) break;
    const std::uint64_t now = monotonic_ms();
    if (now >= next_renewal) {
      if (auto renewed = watch->renew(); !renewed) return renewed;
      next_renewal = now + renew_ms;
    }
    if (now < next_report) continue;
    next_report += report_ms;
    ++reported;
    if (arguments.json != Json::no) {
      console.object(
          object_of(topics, what == What::rate ? "agnocast.topic-hz/1" : "agnocast.topic-bw/1"),
          arguments.json);
    } else if (what == What::rate) {
      print_hz(topics, console);
    } else {
      print_bw(topics, console);
    }
    console.flush();
  }
  return {};
}

}  // namespace

Outcome<void> measure_rate(const Arguments& arguments, Console& console) {
  return measure(arguments, console, What::rate);
}
Outcome<void> measure_bandwidth(const Arguments& arguments, Console& console) {
  return measure(arguments, console, What::bandwidth);
}

}  // namespace agnocast::ctl
