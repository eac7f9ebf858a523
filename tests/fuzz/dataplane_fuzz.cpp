// SPDX-License-Identifier: Apache-2.0
//
// Goal: all code of the data plane that reads another process's memory is safe on any bytes.
// Method: one publisher and two subscriptions in plain memory. The input decides what happens:
// honest operations of one side, and stores of any word into memory that the other may write.
//   take        returns only memory inside the window, whatever the queue says; losses are bounded
//   publish     frees each message once, and none that an honest reader holds; a liar takes no
//               slot beyond its quota
//   recovery    decides by its table and touches only the slot and ring entry that it may
//   verify      ends with an answer

#include <dataplane/frontier.hpp>
#include <dataplane/publisher_core.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/board_steps.hpp>
#include <journal/queue_recovery.hpp>
#include <journal/verify.hpp>
#include <region/windows.hpp>

#include <fuzzer/FuzzedDataProvider.h>

#include <cstdlib>
#include <cstring>
#include <deque>
#include <memory>
#include <optional>
#include <set>
#include <vector>

namespace {

using namespace agnocast;
using namespace agnocast::dataplane;
using M = SharedMemory;

void require(bool condition) {
  if (!condition) std::abort();
}

constexpr int step_count_max = 300;
constexpr std::uint64_t extent = abi::page_bytes, slots = 128, quota = 4, generation = 7;
constexpr std::uint64_t window_base = 0x200000000000, window_bytes = 1 << 20, message_bytes = 16;

// Memory of a process: a header page and one extent. Nobody owns words behind the extent: the
// sanitizer sees a store there.
class Memory {
 public:
  explicit Memory(std::uint64_t bytes) : words_(bytes / 8 + 1) {}
  std::byte* base() { return reinterpret_cast<std::byte*>(words_.data()); }
  std::uint64_t word_count() const { return words_.size() - 1; }

 private:
  std::vector<std::uint64_t> words_;
};

struct Window {
  Memory* region;
  std::uint64_t opened = 0;
  void open() {
    opened = std::max(
        opened, region::load_frontier<M>(region->base(), 0, window_bytes) & ~(abi::page_bytes - 1));
    require(opened <= window_bytes);
  }
  region::Place place_of(std::uint64_t address, std::uint64_t size) const {
    const bool inside =
        address >= window_base && size <= opened && address - window_base <= opened - size;
    return inside ? region::Place::readable : region::Place::outside;
  }
};

struct Freed {
  std::set<std::uint64_t>* live;
  const std::set<std::uint64_t>* held;
  void ring(std::uint64_t, std::uint64_t) {}
  void freed(std::uint64_t slot, std::uint64_t address) {
    require(slot < slots);
    require(live->erase(address) == 1);
    require(held->count(address) == 0);
  }
};

std::uint64_t interesting(FuzzedDataProvider& input) {
  switch (input.ConsumeIntegralInRange(0, 5)) {
    case 0:
      return input.ConsumeIntegral<std::uint64_t>();
    case 1:
      return abi::first_sequence_of(generation) - 2 +
             input.ConsumeIntegralInRange<std::uint64_t>(0, 300);
    case 2:
      return abi::pack_entry(
          abi::first_sequence_of(generation) + input.ConsumeIntegral<std::uint8_t>(),
          input.ConsumeIntegralInRange<std::uint64_t>(0, slots + 1));
    case 3:
      return window_base + input.ConsumeIntegral<std::uint32_t>();
    case 4:
      return ~std::uint64_t{0} << input.ConsumeIntegralInRange(0, 63);
    default:
      return input.ConsumeIntegral<std::uint8_t>();
  }
}

const abi::Qos offered{3, false, true, false, false};
const abi::Qos requested{5, false, true, false, false};

// A hostile publisher, with any content in its region.
// Long because it sets up the region, and then has a branch for each step of either side.
void read_from_a_liar(FuzzedDataProvider& input) {
  const std::uint64_t first = abi::first_sequence_of(generation);
  static Memory board(abi::topic_offset(1));
  Memory queue(extent + abi::publisher_extent_bytes),
      lines(extent + abi::subscription_extent_bytes(1));
  const region::TopicWords<M> topic{board.base(), abi::topic_offset(0)};
  const region::PublisherWords<M> words{queue.base(), extent};
  words.head().store(abi::pack_entry(first, 0));
  journal::BoardSteps<M>(topic).add_publisher(0, generation, {offered, 0, extent, slots});
  const abi::Qos wanted{input.ConsumeIntegralInRange(1u, abi::depth_max), input.ConsumeBool(), true,
                        input.ConsumeBool(), false};
  LinkCore<M> link({topic,
                    words,
                    {lines.base(), extent, 0},
                    0,
                    generation,
                    first,
                    offered,
                    wanted,
                    input.ConsumeBool() ? message_bytes : 0,
                    8});
  if (input.ConsumeBool()) link.want_history(input.ConsumeIntegralInRange(0u, abi::depth_max));
  require(link.link(input.ConsumeBool()));
  Window window{&queue};
  std::deque<std::uint64_t> held;
  for (int step = 0; step < step_count_max && input.remaining_bytes() > 0; ++step) {
    switch (input.ConsumeIntegralInRange(0, 7)) {
      case 0:
      case 1: {
        const std::uint64_t at =
            input.ConsumeBool()
                ? extent + input.ConsumeIntegral<std::uint8_t>() * 8u
                : input.ConsumeIntegralInRange<std::uint64_t>(0, queue.word_count() - 1) * 8;
        M::word(queue.base(), at).store(interesting(input));
        break;
      }
      case 2: {  // a valid entry, whatever its address
        const std::uint64_t sequence = abi::sequence_of(words.head().load()) + 1;
        const std::uint64_t slot = sequence % slots;
        words.slot_address(slot).store(interesting(input));
        words.slot_size(slot).store(input.ConsumeBool() ? message_bytes : interesting(input));
        words.slot_id(slot).store(sequence);
        words.order(sequence).store(abi::pack_entry(sequence, slot));
        words.head().store(abi::pack_entry(sequence, slot));
        break;
      }
      case 3:
      case 4: {
        const std::uint64_t cursor = link.cursor();
        if (const auto taken = link.take(window)) {
          require(window.place_of(taken->address, taken->size) == region::Place::readable);
          require(taken->slot < abi::slot_count_max && taken->sequence >= cursor);
          require(link.cursor() > cursor);
          held.push_back(taken->slot);
        }
        break;
      }
      case 5:
        if (!held.empty()) {
          link.release(held.front());
          held.pop_front();
        }
        break;
      case 6:
        (void)link.next_stamp();
        (void)link.unread();
        link.skip();
        if (input.ConsumeIntegralInRange(0, 15) == 0) {
          journal::BoardSteps<M>(topic).orphan_publisher(0, generation, words.head().load());
          link.observe_publisher();
        }
        break;
      default: {
        (void)journal::verify_queue(words, first, slots, input.ConsumeBool());
        (void)journal::verify_link(region::LinkWords<M>{lines.base(), extent, 0}, words, generation,
                                   first, slots);
        break;
      }
    }
  }
  // Its death: recovery wipes at most one slot and one ring entry.
  const std::vector<std::uint64_t> before(
      reinterpret_cast<std::uint64_t*>(queue.base()),
      reinterpret_cast<std::uint64_t*>(queue.base()) + queue.word_count());
  std::uint64_t final_head = 0;
  const auto decision = journal::recover_queue(words, slots, final_head);
  std::size_t changed = 0;
  for (std::size_t i = 0; i < before.size(); ++i)
    changed += before[i] != M::word(queue.base(), i * 8).load() ? 1 : 0;
  require(changed <= (decision == journal::IntentDecision::roll_back      ? 3u
                      : decision == journal::IntentDecision::roll_forward ? 1u
                                                                          : 0u));
  require(final_head == words.head().load());
}

// A hostile subscriber beside an honest one.
// Long because it sets up the region, and then has a branch for each step of either side.
void publish_to_a_liar(FuzzedDataProvider& input) {
  const std::uint64_t first = abi::first_sequence_of(generation);
  Memory board(abi::topic_offset(1)), queue(extent + abi::publisher_extent_bytes);
  Memory honest_lines(extent + abi::subscription_extent_bytes(1)),
      liars_lines(extent + abi::subscription_extent_bytes(1));
  const region::TopicWords<M> topic{board.base(), abi::topic_offset(0)};
  const region::PublisherWords<M> words{queue.base(), extent};
  words.head().store(abi::pack_entry(first, 0));
  dataplane::store_frontier<M>(queue.base(), 0, window_bytes);
  journal::BoardSteps<M> steps(topic);
  steps.add_publisher(0, generation, {offered, 0, extent, slots});
  auto publisher = std::make_unique<PublisherCore<M>>(
      PublisherCore<M>::Identity{topic, words, 0, generation, first, offered, slots,
                                 input.ConsumeIntegralInRange<std::uint64_t>(0, 2)});
  std::set<std::uint64_t> live, held_addresses;
  Freed environment{&live, &held_addresses};
  for (std::uint64_t s = 0; s < 2; ++s) {
    steps.add_subscription(s, s + 1, {requested, s, extent, quota, 0});
    publisher->attach(s, s + 1, (s == 0 ? honest_lines : liars_lines).base(), extent,
                      offsetof(abi::ClientRegionHeader, wait_set), s, environment);
  }
  LinkCore<M> honest({topic,
                      words,
                      {honest_lines.base(), extent, 0},
                      0,
                      generation,
                      first,
                      offered,
                      requested,
                      message_bytes,
                      16});
  require(honest.link(true));
  Window window{&queue};
  std::deque<Taken> held;
  std::uint64_t number = 0;
  for (int step = 0; step < step_count_max && input.remaining_bytes() > 0; ++step) {
    switch (input.ConsumeIntegralInRange(0, 7)) {
      case 0: {
        const std::uint64_t at =
            input.ConsumeIntegralInRange<std::uint64_t>(0, liars_lines.word_count() - 1) * 8;
        M::word(liars_lines.base(), at).store(interesting(input));
        break;
      }
      case 1: {
        const region::LinkWords<M> line{liars_lines.base(), extent, 0};
        line.publisher_generation().store(input.ConsumeBool() ? generation : interesting(input));
        line.cursor().store(interesting(input));
        break;
      }
      case 2: {
        const region::LinkWords<M> line{liars_lines.base(), extent, 0};
        const std::uint64_t bits = interesting(input);
        for (std::uint64_t word = 0; word < slots / 64; ++word) line.hold(word).store(bits);
        break;
      }
      case 3:
      case 4: {
        const std::uint64_t address = window_base + ++number % 60000 * message_bytes;
        live.insert(address);
        // Depth 5, 4 held by the honest reader, 4 and one more by the liar, three scans: never 128.
        require(publisher->publish({address, message_bytes, number}, environment) ==
                PublishOutcome::published);
        break;
      }
      case 5:
        if (held.size() < quota) {
          if (const auto taken = honest.take(window)) {
            require(live.count(taken->address) == 1);
            held_addresses.insert(taken->address);
            held.push_back(*taken);
          }
        }
        break;
      case 6:
        if (!held.empty()) {
          held_addresses.erase(held.front().address);
          honest.release(held.front().slot);
          held.pop_front();
        }
        break;
      default:
        publisher->scan(environment);
        break;
    }
  }
  require(honest.malformed() == 0);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzedDataProvider input(data, size);
  if (input.ConsumeBool()) {
    read_from_a_liar(input);
  } else {
    publish_to_a_liar(input);
  }
  return 0;
}
