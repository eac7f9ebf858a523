// SPDX-License-Identifier: Apache-2.0
//
// Overview: the whole system as rows, one a topic, for top. A row shows the messages since the
// last look at the counters or, at the first look, what the stamps of the last messages show.
//
// A look must be cheap enough to run twice a second for 500 topics, so it reads heads, cursors and
// hold words, and only those slots that are held.
#pragma once

#include <ctl/cli/console.hpp>
#include <ctl/snapshot/system.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// The worst trouble of a topic: the first of these that is true.
enum class Trouble : std::uint8_t {
  refused,  // X  endpoints were refused, or do not match in quality of service
  lagging,  // L  a reader has almost its depth of unread messages
  holding,  // H  a subscription holds a message older than a second
  dead,     // D  a publisher is gone, and not all its messages are read
  running,  // R
  idle,     // I
};

struct Row {
  Trouble trouble = Trouble::idle;
  const Topic* topic = nullptr;  // of the system that it was made from
  double rate_hz = 0;            // the sum of the known rates
  bool rate_known = true;
  std::uint64_t message_bytes = 0;
  double bytes_per_second = 0;
  std::uint64_t publishers = 0, subscriptions = 0;
  std::uint64_t lag = 0;   // messages, of the slowest reader
  std::uint64_t held = 0;  // messages
  std::uint64_t oldest_held_ns = 0;
  std::uint64_t lost = 0;          // messages, of all subscriptions since their start
  std::vector<std::string> notes;  // the endpoints concerned, as text
};

struct Totals {
  std::uint64_t topics = 0, processes = 0, heap_bytes = 0, lost = 0, refused = 0, recoveries = 0;
  std::uint64_t uptime_ns = 0;
};

class Overview {
 public:
  /// Returns the rows of one domain, or of all.
  std::vector<Row> look(const System& system, bool all_domains, std::uint64_t domain,
                        std::uint64_t now_ns);
  static Totals totals_of(const System& system, const std::vector<Row>& rows);

 private:
  struct Seen {
    std::uint64_t count = 0, bytes = 0;
    std::uint64_t newest_ns = 0;  // when the newest message was committed
    std::optional<double> rate_hz;
    std::uint64_t message_bytes = 0;
  };
  Seen look_at(const System& system, const Endpoint& publisher, std::uint64_t now_ns) const;

  std::map<std::uint64_t, Seen> seen_;  // by generation of the publisher
};

char letter_of(Trouble trouble) noexcept;
const char* word_of(Trouble trouble) noexcept;
/// Sorts by a word of options::sort.
void sort_rows(std::vector<Row>& rows, const std::string& column);
Object object_of(const Row& row);
Object object_of(const Totals& totals);

}  // namespace agnocast::ctl
