// SPDX-License-Identifier: Apache-2.0
//
// HostileNode: a client that the daemon takes for an ordinary one, and that then writes anything
// it likes. It makes the requests that any client may make, and keeps every descriptor it is
// given.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <base/descriptors/doorbell.hpp>
#include <base/memory/memfd.hpp>
#include <region/views.hpp>
#include <tests/hostile/stage.hpp>

#include <sys/mman.h>

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {

/// sizeof(Flat), checked in messages.hpp.
inline constexpr std::uint64_t flat_bytes = 64;

class HostileNode {
 public:
  using M = SharedMemory;

  /// `window_file_bytes`: the length of its window's file; the whole window by default. `domain`:
  /// ROS_DOMAIN_ID.
  explicit HostileNode(const std::string& socket_path, std::uint64_t window_file_bytes = 0,
                       std::uint64_t domain = 0)
      : path_(socket_path), wire_(socket_path), window_file_bytes_(window_file_bytes) {
    Incoming answer = wire_.hello(abi::fingerprint(), domain);
    EXPECT_EQ(answer.opcode(), wire::Opcode::welcome) << answer.refused_text();
    if (answer.opcode() != wire::Opcode::welcome) return;
    welcome_ = answer.as<wire::Welcome>();
    fds_ = std::move(answer.fds);
    region_ = std::move(
        Mapping::map(fds_[1].get(), welcome_.client_region_bytes, Mapping::Access::read_write)
            .value());
  }

  WireClient& wire() noexcept { return wire_; }
  const wire::Welcome& welcome() const noexcept { return welcome_; }
  int board_fd() const { return fds_[0].get(); }
  int region_fd() const { return fds_[1].get(); }
  std::byte* region() const { return region_.base(); }
  abi::SharedWord& word(std::uint64_t offset) const { return M::word(region_.base(), offset); }

  /// The first window, mapped at any address: attackers do not follow their own pointers.
  const wire::WindowOpened& open_window() {
    if (window_fds_.empty()) {
      Incoming opened = wire_.open_window(0);
      EXPECT_EQ(opened.opcode(), wire::Opcode::window_opened) << opened.refused_text();
      window_ = opened.as<wire::WindowOpened>();
      window_fds_ = std::move(opened.fds);
      EXPECT_TRUE(lengthen(window_fds_[0].get(),
                           window_file_bytes_ != 0 ? window_file_bytes_ : window_.bytes));
      heap_ = std::move(
          Mapping::map(window_fds_[0].get(), window_.bytes, Mapping::Access::read_write).value());
      // An honest process would describe itself like this; from here on it lies.
      word(128 + offsetof(abi::WindowEntry, base)).store(window_.base);
      word(128 + offsetof(abi::WindowEntry, length)).store(window_.bytes);
      word(128 + offsetof(abi::WindowEntry, frontier)).store(std::uint64_t{1} << 20);
    }
    return window_;
  }
  int window_fd() const { return window_fds_[0].get(); }
  int window_read_fd() const { return window_fds_[1].get(); }
  std::byte* heap() const { return heap_.base(); }

  void open_wait_set() {
    Incoming opened = wire_.open_wait_set();
    EXPECT_EQ(opened.opcode(), wire::Opcode::wait_set_opened) << opened.refused_text();
    doorbells_ = std::move(opened.fds);
    has_wait_set_ = true;
  }
  /// A subscription of this depth with an additional wait set. Returns false if the daemon refused
  /// it.
  bool subscribe_with_wait_set(const char* topic, std::uint64_t wait_set, std::uint32_t depth) {
    Incoming opened = wire_.open_wait_set(wait_set);
    if (opened.opcode() != wire::Opcode::wait_set_opened) return false;
    for (UniqueFd& fd : opened.fds) more_doorbells_.push_back(std::move(fd));
    auto body = WireClient::endpoint(topic, {depth, false, true, false, false});
    static std::map<std::string, std::pair<wire::Name, std::uint64_t>> types;  // a dump costs time
    if (types.count(topic) == 0) types[topic] = type_of(topic);
    body.type = types[topic].first;
    body.layout_hash = types[topic].second;
    body.wait_set = wait_set;
    body.quota = 1;  // any process may hold that many of others
    return wire_.ask(wire::Opcode::create_subscription, body).opcode() ==
           wire::Opcode::endpoint_created;
  }
  /// Closes the receivers of the own wait set, which no other process has.
  void close_doorbells() { doorbells_.clear(); }

  /// Creates an endpoint on an existing topic, of its type.
  wire::EndpointCreated join(wire::Kind kind, const char* topic, abi::Qos qos = {},
                             std::uint64_t quota = 64) {
    auto body = body_like(topic, topic, qos);
    body.quota = quota;
    if (kind == wire::Kind::publisher) {
      open_window();
    } else if (!has_wait_set_) {
      open_wait_set();
    }
    const Incoming made =
        wire_.ask(kind == wire::Kind::publisher ? wire::Opcode::create_publisher
                                                : wire::Opcode::create_subscription,
                  body);
    EXPECT_EQ(made.opcode(), wire::Opcode::endpoint_created) << made.refused_text();
    return made.opcode() == wire::Opcode::endpoint_created ? made.as<wire::EndpointCreated>()
                                                           : wire::EndpointCreated{};
  }
  /// Returns the request for an endpoint on `topic`, of the type that `other` has.
  wire::CreateEndpoint body_like(const char* other, const std::string& topic, const abi::Qos& qos) {
    auto body = WireClient::endpoint(topic, qos);
    const auto type = type_of(other);
    body.type = type.first;
    body.layout_hash = type.second;
    return body;
  }
  /// The announcement of one endpoint of another process, with its descriptors.
  struct Announced {
    wire::Announcement body{};
    std::vector<UniqueFd> fds;
  };
  Announced announced() {
    Announced about;
    about.body = wire_.expect<wire::Announcement>(wire::Opcode::announce, &about.fds);
    return about;
  }
  /// Eventfd (for a process of the same user) and datagram socket of the own wait set.
  const std::vector<UniqueFd>& doorbells() const { return doorbells_; }

  region::PublisherWords<M> queue(const wire::EndpointCreated& publisher) const {
    return {region_.base(), publisher.extent};
  }
  region::LinkWords<M> line(const wire::EndpointCreated& subscription,
                            std::uint64_t publisher) const {
    return {region_.base(), subscription.extent, publisher};
  }
  abi::SharedWord& armed() const { return word(offsetof(abi::ClientRegionHeader, wait_set)); }
  abi::SharedWord& frontier(std::uint64_t window = 0) const {
    return word(128 + window * sizeof(abi::WindowEntry) + offsetof(abi::WindowEntry, frontier));
  }

  /// Commits a message as the protocol requires, at any claimed address.
  void commit(const wire::EndpointCreated& publisher, std::uint64_t address, std::uint64_t size) {
    const auto words = queue(publisher);
    const std::uint64_t sequence = abi::sequence_of(words.head().load()) + 1;
    const std::uint64_t slot = sequence % publisher.slot_count;
    words.slot_address(slot).store(address);
    words.slot_size(slot).store(size);
    words.slot_id(slot).store(sequence);
    words.order(sequence).store(abi::pack_entry(sequence, slot));
    words.head().store(abi::pack_entry(sequence, slot));
  }

 private:
  std::pair<wire::Name, std::uint64_t> type_of(const std::string& topic) {
    WireClient observer(path_);
    wire::Observe observe{};
    observe.fingerprint = abi::fingerprint();
    EXPECT_EQ(observer.ask(wire::Opcode::observe, observe).opcode(), wire::Opcode::observed);
    observer.send(wire::Opcode::dump, wire::Dump{});
    std::pair<wire::Name, std::uint64_t> found{wire_name("test/msg/Type"), 1};
    for (;;) {
      const Incoming packet = observer.next();
      if (packet.opcode() == wire::Opcode::dump_topic) {
        const auto body = packet.as<wire::DumpTopic>();
        if (topic == body.name.text) found = {body.type, body.layout_hash};
      }
      if (packet.bytes.empty() || packet.opcode() == wire::Opcode::dump_end) return found;
    }
  }

  std::string path_;
  WireClient wire_;
  std::uint64_t window_file_bytes_;
  wire::Welcome welcome_{};
  std::vector<UniqueFd> fds_, window_fds_, doorbells_, more_doorbells_;
  Mapping region_, heap_;
  wire::WindowOpened window_{};
  bool has_wait_set_ = false;
};

}  // namespace agnocast::test
