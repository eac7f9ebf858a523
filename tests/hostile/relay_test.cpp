// SPDX-License-Identifier: Apache-2.0
//
// Goal: a relay passes on nothing that lies outside the memory of the publisher whose message it was
// handed, and does not crash by it. Method: a relay of the honest user reads a stream that a rule keeps from
// others, and texts of anybody; a publisher of another user sends it texts that lie in the windows of the
// stream, nowhere, or in both in turn while they are read. What the bridge does of it has
// unit_bridge_cdr.

#include <tests/hostile/hostile_node.hpp>

#include <sys/mman.h>
#include <sys/socket.h>

#include <cstring>
#include <sstream>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

/// As libstdc++ has it.
struct RawString {
  std::uint64_t data = 0, size = 0;
  char local[16] = {};
};
static_assert(sizeof(RawString) == sizeof(std::string));

/// Where the heaps of all other processes begin, from what everybody may look at.
std::vector<std::uint64_t> windows_of_others(const std::string& path, std::uint64_t own) {
  std::vector<std::uint64_t> all;
  WireClient observer(path);
  wire::Observe observe{};
  observe.fingerprint = abi::fingerprint();
  EXPECT_EQ(observer.ask(Opcode::observe, observe).opcode(), Opcode::observed);
  observer.send(Opcode::dump, wire::Dump{});
  for (;;) {
    const Incoming packet = observer.next();
    if (packet.bytes.empty() || packet.opcode() == Opcode::dump_end) return all;
    if (packet.opcode() != Opcode::dump_process || packet.fds.empty()) continue;
    const auto header = Mapping::map(packet.fds[0].get(), abi::page_bytes, Mapping::Access::read);
    EXPECT_TRUE(header);
    if (!header) continue;
    const std::uint64_t base =
        reinterpret_cast<const abi::ClientRegionHeader*>(header->base())->window[0].base.load();
    if (base != 0 && base != own) all.push_back(base);
  }
}

enum : std::size_t { honest_texts, lies };

/// Publishes texts; where each lies says `place`, which may go on changing it.
void spread_rumors(const std::string& path, Attack& attack) {
  HostileNode node(path);
  const auto publisher = node.join(Kind::publisher, "/rumor");
  const auto reader = node.announced();
  EXPECT_EQ(reader.body.kind, Kind::subscription);
  ASSERT_EQ(reader.fds.size(), 2u) << "region and datagram socket";
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
    static_cast<void>(::send(reader.fds[1].get(), "", 1, MSG_DONTWAIT | MSG_NOSIGNAL));
    ++attack.word(number % places.size() == 0 ? honest_texts : lies);
    ++number;
    // While it is read: now one's own, now another's.
    const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(2);
    while (std::chrono::steady_clock::now() < end) {
      auto* const words = reinterpret_cast<volatile std::uint64_t*>(node.heap() + object);
      words[0] = others[0];
      words[0] = at;
    }
  }
}

TEST(HostileRelay, PassesOnNothingOfAnotherPublishersMemory) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.more = "[[access]]\ntopic = \"/secret\"\nsubscribe = [\"uid:" +
                       std::to_string(honest_uid) + "\"]\n"});
  const auto secretive = stage.another_honest_process();
  SteeredProcess relay({AGNOCAST_RELAY_NODE, std::to_string(honest_uid)},
                       {"AGNOCAST_SOCKET=" + stage.socket_path()});
  ASSERT_EQ(relay.ask("read /secret"), "ok");
  ASSERT_EQ(relay.ask("relay /rumor"), "ok");
  ASSERT_EQ(secretive->ask("publish /secret"), "ok");
  std::uint64_t read = 0, relayed = 0, refused = 0, strange = 0;
  const auto look = [&] {
    std::istringstream state(relay.ask("state"));
    state >> read >> relayed >> refused >> strange;
    EXPECT_FALSE(state.fail()) << "the relay does not answer: " << state.str();
    return !state.fail();
  };
  ASSERT_TRUE(eventually([&] { return look() && read > 0; }));
  Attacker attacker([&](Attack& attack) { spread_rumors(stage.socket_path(), attack); });
  if (!attacker.wait_until_ready()) return attacker.end();
  EXPECT_TRUE(eventually([&] { return !look() || (relayed >= 20 && refused >= 200); }))
      << relayed << " relayed, " << refused << " refused";
  EXPECT_EQ(strange, 0u) << "of " << relayed << " texts that were passed on";
  attacker.end();
  const std::uint64_t before = read;
  EXPECT_TRUE(eventually([&] { return !look() || read > before; })) << "it goes on";
  std::printf("%llu texts relayed, %llu refused\n", static_cast<unsigned long long>(relayed),
              static_cast<unsigned long long>(refused));
}

}  // namespace
}  // namespace agnocast::test
