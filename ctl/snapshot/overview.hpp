// SPDX-License-Identifier: Apache-2.0
//
// Overview: the whole system as rows, one a topic, for top. Made from looks at the counters: what came
// since the last look, or, at the first one, what the stamps of the last messages say.
//
// It has to be cheap enough to be made twice a second for 500 topics, so it reads heads, cursors and hold
// words and no slot but of what is held.
#pragma once

#include <ctl/cli/console.hpp>
#include <ctl/snapshot/system.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// What hurts most of a topic; in this order, the first that is true.
enum class Trouble : std::uint8_t {
  refused,  // X  endpoints were refused, or are not matched for their quality of service
  lagging,  // L  a reader has nearly as much unread as its depth
  holding,  // H  somebody holds a message for more than a second
  dead,     // D  a publisher is gone and not read to its end
  running,  // R
  idle,     // I
};

struct Row {
  Trouble trouble = Trouble::idle;
  const Topic* topic = nullptr;  // of the look that it was made from
  double rate_hz = 0;            // of the publishers of which it is known
  bool rate_known = true;
  std::uint64_t message_bytes = 0;
  double bytes_per_second = 0;
  std::uint64_t publishers = 0, subscriptions = 0;
  std::uint64_t lag = 0;   // of the slowest reader, messages
  std::uint64_t held = 0;  // messages
  std::uint64_t oldest_held_ns = 0;
  std::uint64_t lost = 0;          // messages, of all subscriptions since they began
  std::vector<std::string> notes;  // who, for people
};

struct Totals {
  std::uint64_t topics = 0, processes = 0, heap_bytes = 0, lost = 0, refused = 0, recoveries = 0;
  std::uint64_t uptime_ns = 0;
};

class Overview {
 public:
  /// Rows of the domain, or of all.
  std::vector<Row> look(const System& system, bool all_domains, std::uint64_t domain,
                        std::uint64_t now_ns);
  static Totals totals_of(const System& system, const std::vector<Row>& rows);

 private:
  struct Seen {
    std::uint64_t count = 0, bytes = 0;
    std::uint64_t newest_ns = 0;  // when the newest was committed
    std::optional<double> rate_hz;
    std::uint64_t message_bytes = 0;
  };
  Seen look_at(const System& system, const Endpoint& publisher, std::uint64_t now_ns) const;

  std::map<std::uint64_t, Seen> seen_;  // by generation of the publisher
};

char letter_of(Trouble trouble) noexcept;
const char* word_of(Trouble trouble) noexcept;
/// By a word of options::sort.
void sort_rows(std::vector<Row>& rows, const std::string& column);
Object object_of(const Row& row);
Object object_of(const Totals& totals);

}  // namespace agnocast::ctl
