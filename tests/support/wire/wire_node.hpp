// SPDX-License-Identifier: Apache-2.0
//
// WireNode: a small honest client on a raw connection, with the shipped data plane on the daemon's
// regions. At most one publisher and one subscription; messages carry their number and a pattern
// behind a pointer, freed ones are poisoned.
//
// It does what docs/control-plane.md asks of a client, one packet at a time, when the test tells
// it to (pump, wait_for). A short reference of that contract, small enough to run in a child that
// dies at a crash point.
#pragma once

#include <base/descriptors/doorbell.hpp>
#include <base/memory/memfd.hpp>
#include <client/heap/peer_heap.hpp>
#include <dataplane/frontier.hpp>
#include <dataplane/publisher_core.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/verify.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <sys/mman.h>

#include <cstring>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <vector>

namespace agnocast::test {

class WireNode {
 public:
  using M = SharedMemory;
  static constexpr std::uint64_t message_bytes = 8192;
  static constexpr std::uint64_t element_count = 700;

  struct Message {
    std::uint64_t number;
    std::uint64_t count;
    const std::uint64_t* data;
  };

  explicit WireNode(const std::string& socket_path) : wire_(socket_path) {
    Incoming answer = wire_.hello();
    if (answer.opcode() != wire::Opcode::welcome || answer.fds.size() != 2) {
      ADD_FAILURE() << "no welcome: " << answer.refused_text();
      return;
    }
    welcome_ = answer.as<wire::Welcome>();
    board_ = std::move(
        Mapping::map(answer.fds[0].get(), abi::board_bytes, Mapping::Access::read).value());
    region_ = std::move(
        Mapping::map(answer.fds[1].get(), welcome_.client_region_bytes, Mapping::Access::read_write)
            .value());
  }
  WireNode(const WireNode&) = delete;
  WireNode& operator=(const WireNode&) = delete;
  ~WireNode() {
    if (heap_ != nullptr) ::munmap(heap_, window_.bytes);
  }

  WireClient& wire() noexcept { return wire_; }
  const wire::Welcome& welcome() const noexcept { return welcome_; }
  const wire::EndpointCreated& publisher() const noexcept { return publisher_; }
  const wire::EndpointCreated& subscription() const noexcept { return subscription_; }
  const wire::WindowOpened& window() const noexcept { return window_; }
  region::TopicWords<M> topic(std::uint32_t index) const {
    return {board_.base(), abi::topic_offset(index)};
  }

  // --- publisher
  bool create_publisher(const char* topic_name, const abi::Qos& qos) {
    Incoming opened = wire_.open_window(0);
    if (opened.opcode() != wire::Opcode::window_opened) return false;
    window_ = opened.as<wire::WindowOpened>();
    // Readers may assume that all of it is in use.
    if (!lengthen(opened.fds[0].get(), window_.bytes)) return false;
    // The arena is ours by contract; a forked child inherits its parent's reservation there.
    heap_ = static_cast<std::byte*>(::mmap(reinterpret_cast<void*>(window_.base), window_.bytes,
                                           PROT_READ | PROT_WRITE, MAP_SHARED | MAP_FIXED,
                                           opened.fds[0].get(), 0));
    if (heap_ == MAP_FAILED) return false;
    ::madvise(heap_, window_.bytes, MADV_DONTFORK);  // a child of ours may itself be a client
    for (std::uint64_t at = 0; at < heap_used_bytes; at += message_bytes)
      blocks_.push_back(window_.base + at);
    dataplane::store_frontier<M>(region_.base(), 0, heap_used_bytes);
    const Incoming created = wire_.create_publisher(topic_name, qos);
    if (created.opcode() != wire::Opcode::endpoint_created) return false;
    publisher_ = created.as<wire::EndpointCreated>();
    core_ = std::make_unique<dataplane::PublisherCore<M>>(
        dataplane::PublisherCore<M>::Identity{topic(publisher_.topic),
                                              {region_.base(), publisher_.extent},
                                              publisher_.index,
                                              publisher_.generation,
                                              publisher_.first_sequence,
                                              qos,
                                              publisher_.slot_count,
                                              0});
    return true;
  }
  bool publish(std::uint64_t number) {
    if (blocks_.empty()) return false;
    const std::uint64_t address = blocks_.back();
    blocks_.pop_back();
    auto* const data = reinterpret_cast<std::uint64_t*>(address + 1024);
    for (std::uint64_t i = 0; i < element_count; ++i) data[i] = element(number, i);
    *reinterpret_cast<Message*>(address) = {number, element_count, data};
    Environment environment{*this};
    if (core_->publish({address, sizeof(Message), number}, environment) ==
        dataplane::PublishOutcome::published)
      return true;
    free(address);
    return false;
  }
  void scan() {
    Environment environment{*this};
    core_->scan(environment);
  }
  region::PublisherWords<M> queue() const { return {region_.base(), publisher_.extent}; }
  std::uint64_t allocated_count() const { return core_->allocated_count(); }
  std::size_t attached_count() const { return attached_.size(); }

  // --- subscription
  bool create_subscription(const char* topic_name, const abi::Qos& qos) {
    Incoming opened = wire_.open_wait_set();
    if (opened.opcode() != wire::Opcode::wait_set_opened || opened.fds.size() != 2) return false;
    doorbells_ = DoorbellReceiver(std::move(opened.fds[0]), std::move(opened.fds[1]));
    const Incoming created = wire_.create_subscription(topic_name, qos);
    if (created.opcode() != wire::Opcode::endpoint_created) return false;
    subscription_ = created.as<wire::EndpointCreated>();
    requested_ = qos;
    return true;
  }
  /// Takes, checks and holds the next message of any publisher, if there is one.
  std::optional<std::uint64_t> take() {
    for (auto& [index, link] : links_) {
      HeapLook windows(*peers_.at(link.client).heap, Unannounced::awaited);
      if (const auto taken = link.core.take(windows)) {
        const auto& message = *reinterpret_cast<const Message*>(taken->address);
        EXPECT_TRUE(intact(message)) << "message " << message.number;
        held_.push_back({index, taken->slot, taken->address, message.number});
        return message.number;
      }
    }
    return std::nullopt;
  }
  /// Claims holds on slots [0, count) of a publisher, whether true or not.
  bool claim_holds(std::uint64_t publisher, std::uint64_t count) {
    if (links_.count(publisher) == 0) return false;
    const region::LinkWords<M> line{region_.base(), subscription_.extent, publisher};
    line.hold(0).store((std::uint64_t{1} << count) - 1, std::memory_order_seq_cst);
    return true;
  }
  /// Releases the oldest held message after checking it again.
  bool release() {
    if (held_.empty()) return false;
    const Held held = held_.front();
    held_.pop_front();
    const auto& message = *reinterpret_cast<const Message*>(held.address);
    EXPECT_TRUE(intact(message) && message.number == held.number)
        << "message " << held.number << " changed while held";
    links_.at(held.publisher).core.release(held.slot);
    return true;
  }
  const DoorbellReceiver& doorbells() const noexcept { return doorbells_; }
  /// Returns the first broken invariant of the queues of orphans, as their reader sees them.
  journal::Invariant verify_orphans() const {
    for (const auto& [index, link] : links_) {
      if (orphaned_.count(link.generation) == 0) continue;
      const std::uint64_t slot_count =
          topic(subscription_.topic)
              .publisher(index, offsetof(abi::PublisherEntry, slot_count))
              .load(std::memory_order_relaxed);
      const auto broken = journal::verify_queue(link.words, link.first_sequence, slot_count, true);
      if (broken != journal::Invariant::none) return broken;
    }
    return journal::Invariant::none;
  }
  std::size_t link_count() const { return links_.size(); }
  std::size_t held_count() const { return held_.size(); }
  std::uint64_t lost() const {
    std::uint64_t lost = 0;
    for (const auto& [index, link] : links_) lost += link.core.lost();
    return lost;
  }
  const std::set<std::uint64_t>& orphaned() const { return orphaned_; }
  /// Ends every link to an orphan that is drained and not held, and reports it; then unmaps the
  /// regions without remaining links.
  void unlink_drained(bool and_regions = true) {
    for (auto at = links_.begin(); at != links_.end();) {
      const bool held = [&] {
        for (const Held& h : held_) {
          if (h.publisher == at->first) return true;
        }
        return false;
      }();
      if (!at->second.core.drained() || held) {
        ++at;
        continue;
      }
      at->second.core.unlink();
      wire_.unlinked(wire::Kind::publisher, subscription_.topic, at->first, at->second.generation);
      orphaned_.erase(at->second.generation);
      at = links_.erase(at);
    }
    if (and_regions) unmap_regions();
  }
  void unmap_regions() {
    for (auto at = peers_.begin(); at != peers_.end();) {
      bool used = false;
      for (const auto& [index, link] : links_) used = used || link.client == at->first;
      for (const auto& [index, client] : attached_) used = used || client == at->first;
      if (used) {
        ++at;
        continue;
      }
      const std::uint64_t client = at->first, generation = at->second.generation;
      at = peers_.erase(at);  // unmapped first, reported afterwards
      wire_.unlinked(wire::Kind::region, 0, client, generation);
    }
  }

  // --- packets
  void pump() {
    while (auto packet = wire_.poll()) handle(std::move(*packet));
  }
  /// Handles packets until the condition holds; false if none comes for a minute.
  template <class Condition>
  [[nodiscard]] bool wait_for(Condition condition) {
    while (!condition()) {
      Incoming packet = wire_.next();
      if (packet.bytes.empty()) return false;
      handle(std::move(packet));
    }
    return true;
  }
  void handle(Incoming packet) {
    switch (packet.opcode()) {
      case wire::Opcode::announce:
        on_announce(packet.as<wire::Announcement>(), std::move(packet.fds));
        break;
      case wire::Opcode::window_announced: {
        const auto body = packet.as<wire::WindowAnnounced>();
        if (auto peer = peers_.find(body.client); peer != peers_.end()) {
          EXPECT_TRUE(peer->second.heap->add({body.window, body.base, body.bytes, body.first},
                                             std::move(packet.fds[0])));
        }
        break;
      }
      case wire::Opcode::forget: {
        const auto body = packet.as<wire::Reference>();
        core_->detach(body.index, body.generation);
        attached_.erase(body.index);
        scan();
        wire_.unlinked(wire::Kind::subscription, body.topic, body.index, body.generation);
        unmap_regions();
        break;
      }
      case wire::Opcode::orphaned: {
        const auto body = packet.as<wire::Orphaned>();
        if (auto link = links_.find(body.index); link != links_.end()) {
          link->second.core.observe_publisher();
          orphaned_.insert(body.generation);
        }
        break;
      }
      case wire::Opcode::kick:
        if (core_) scan();
        break;
      default:
        ADD_FAILURE() << "unexpected packet " << static_cast<unsigned>(packet.opcode()) << " "
                      << packet.refused_text();
    }
  }

 private:
  static constexpr std::uint64_t heap_used_bytes = 1 << 20;

  struct Environment {
    WireNode& node;
    void ring(std::uint64_t, std::uint64_t) {}
    void freed(std::uint64_t, std::uint64_t address) { node.free(address); }
  };
  struct Peer {
    std::uint64_t generation;
    std::unique_ptr<Mapping> region;
    std::unique_ptr<PeerHeap> heap;
  };
  struct Link {
    std::uint64_t client;
    std::uint64_t generation;
    std::uint64_t first_sequence;
    region::PublisherWords<M> words;
    dataplane::LinkCore<M> core;
  };
  struct Held {
    std::uint64_t publisher, slot, address, number;
  };

  static std::uint64_t element(std::uint64_t number, std::uint64_t i) {
    return (number + 1) * 0x9e3779b97f4a7c15 ^ i;
  }
  static bool intact(const Message& message) {
    if (message.count != element_count) return false;
    for (std::uint64_t i = 0; i < element_count; ++i) {
      if (message.data[i] != element(message.number, i)) return false;
    }
    return true;
  }
  void free(std::uint64_t address) {
    std::memset(reinterpret_cast<void*>(address), 0xdd, message_bytes);
    blocks_.push_back(address);
  }
  void on_announce(const wire::Announcement& body, std::vector<UniqueFd> fds) {
    auto found = peers_.find(body.client);
    if (found != peers_.end() && found->second.generation != body.client_generation) {
      ADD_FAILURE() << "the place of a process is reused while it is mapped here";
      return;
    }
    if (found == peers_.end()) {
      auto region = std::make_unique<Mapping>(std::move(
          Mapping::map(fds[0].get(), welcome_.client_region_bytes, Mapping::Access::read).value()));
      auto heap = std::make_unique<PeerHeap>(region->base());
      found = peers_
                  .emplace(body.client,
                           Peer{body.client_generation, std::move(region), std::move(heap)})
                  .first;
      for (std::uint32_t w = 0; w < body.window_count; ++w) {
        const wire::Announcement::Window& window = body.window[w];
        const auto added = found->second.heap->add({w, window.base, window.bytes, window.first},
                                                   std::move(fds[1 + w]));
        EXPECT_TRUE(added) << (added ? "" : added.error().what);
      }
    }
    Peer& peer = found->second;
    if (body.kind == wire::Kind::publisher) {
      const auto [link, fresh] = links_.emplace(
          body.index,
          Link{body.client,
               body.generation,
               body.first_sequence,
               {peer.region->base(), body.extent},
               dataplane::LinkCore<M>({topic(body.topic),
                                       {peer.region->base(), body.extent},
                                       {region_.base(), subscription_.extent, body.index},
                                       body.index,
                                       body.generation,
                                       body.first_sequence,
                                       abi::unpack_qos(body.qos),
                                       requested_,
                                       0,
                                       1,
                                       subscription_.index})});
      EXPECT_TRUE(fresh) << "an index is reused while it is linked here";
      EXPECT_TRUE(link->second.core.link(body.from_start != 0));
    } else {
      Environment environment{*this};
      core_->attach(
          body.index, body.generation, peer.region->base(), body.extent,
          offsetof(abi::ClientRegionHeader, wait_set) + body.wait_set * sizeof(abi::WaitSetLine),
          body.index, environment);
      attached_[body.index] = body.client;
      scan();
    }
  }

  WireClient wire_;
  wire::Welcome welcome_{};
  Mapping board_, region_;
  wire::EndpointCreated publisher_{}, subscription_{};
  wire::WindowOpened window_{};
  std::byte* heap_ = nullptr;
  std::vector<std::uint64_t> blocks_;
  std::unique_ptr<dataplane::PublisherCore<M>> core_;
  abi::Qos requested_;
  DoorbellReceiver doorbells_;
  std::map<std::uint64_t, Peer> peers_;              // by client
  std::map<std::uint64_t, Link> links_;              // by publisher index
  std::map<std::uint64_t, std::uint64_t> attached_;  // subscription index → client
  std::set<std::uint64_t> orphaned_;                 // generations
  std::deque<Held> held_;
};

}  // namespace agnocast::test
