// SPDX-License-Identifier: Apache-2.0
//
// Rumors: a publisher of texts that lie in the windows of others, nowhere, or alternate between
// both while they are read; now and then it publishes an honest one, of the letter h alone.
#pragma once

#include <tests/hostile/hostile_node.hpp>

#include <sys/mman.h>
#include <sys/socket.h>

#include <chrono>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {

/// The layout of std::string in libstdc++.
struct RawString {
  std::uint64_t data = 0, size = 0;
  char local[16] = {};
};
static_assert(sizeof(RawString) == sizeof(std::string));

/// Returns where the heaps of all other processes begin, as any observer can see.
inline std::vector<std::uint64_t> windows_of_others(const std::string& path, std::uint64_t own) {
  std::vector<std::uint64_t> all;
  WireClient observer(path);
  wire::Observe observe{};
  observe.fingerprint = abi::fingerprint();
  EXPECT_EQ(observer.ask(wire::Opcode::observe, observe).opcode(), wire::Opcode::observed);
  observer.send(wire::Opcode::dump, wire::Dump{});
  for (;;) {
    const Incoming packet = observer.next();
    if (packet.bytes.empty() || packet.opcode() == wire::Opcode::dump_end) return all;
    if (packet.opcode() != wire::Opcode::dump_process || packet.fds.empty()) continue;
    const auto header = Mapping::map(packet.fds[0].get(), abi::page_bytes, Mapping::Access::read);
    EXPECT_TRUE(header);
    if (!header) continue;
    const std::uint64_t base =
        reinterpret_cast<const abi::ClientRegionHeader*>(header->base())->window[0].base.load();
    if (base != 0 && base != own) all.push_back(base);
  }
}

enum : std::size_t { honest_texts, lies };

/// Publishes texts; `place` determines where each lies, and may go on changing it.
inline void spread_rumors(const std::string& path, Attack& attack, std::uint64_t domain = 0) {
  HostileNode node(path, 0, domain);
  const auto publisher = node.join(wire::Kind::publisher, "/rumor");
  std::vector<UniqueFd> doorbells;
  const auto meet = [&](const wire::Announcement& body, std::vector<UniqueFd> fds) {
    EXPECT_EQ(body.kind, wire::Kind::subscription);
    ASSERT_EQ(fds.size(), 2u) << "region and datagram socket";
    doorbells.push_back(std::move(fds[1]));
  };
  HostileNode::Announced first = node.announced();
  meet(first.body, std::move(first.fds));
  const std::uint64_t base = node.open_window().base;
  constexpr std::uint64_t text_at = 65536, text_bytes = 4096, objects = 64;
  std::memset(node.heap() + text_at, 'h', text_bytes);
  const std::vector<std::uint64_t> others = windows_of_others(path, base);
  EXPECT_GE(others.size(), 1u);
  std::vector<std::pair<std::uint64_t, std::uint64_t>> places{{base + text_at, text_bytes}};
  for (const std::uint64_t other : others) {
    places.emplace_back(other, 64);
    places.emplace_back(other + 4096, 1 << 16);
  }
  places.insert(places.end(), {{0, 8},
                               {8, 1 << 20},
                               {~std::uint64_t{0} - 7, 64},
                               {base + text_at, ~std::uint64_t{0}},
                               {base + text_at, std::uint64_t{1} << 40},
                               {base + (std::uint64_t{64} << 20) - 8, 16}});
  attack.ready();
  std::uint64_t number = 0;
  while (attack.goes_on()) {
    const auto& [at, bytes] = places[number % places.size()];
    const std::uint64_t object = 4096 + number % objects * sizeof(RawString);
    const RawString text{at, bytes, {}};
    std::memcpy(node.heap() + object, &text, sizeof text);
    node.commit(publisher, base + object, sizeof text);
    while (auto packet = node.wire().poll()) {
      if (packet->opcode() == wire::Opcode::announce)
        meet(packet->as<wire::Announcement>(), std::move(packet->fds));
    }
    for (const UniqueFd& doorbell : doorbells)
      static_cast<void>(::send(doorbell.get(), "", 1, MSG_DONTWAIT | MSG_NOSIGNAL));
    ++attack.word(number % places.size() == 0 ? honest_texts : lies);
    ++number;
    // During the read: alternately its own memory and another's.
    const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(2);
    while (std::chrono::steady_clock::now() < end) {
      auto* const words = reinterpret_cast<volatile std::uint64_t*>(node.heap() + object);
      words[0] = others[0];
      words[0] = at;
    }
  }
}

}  // namespace agnocast::test
