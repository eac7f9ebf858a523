// SPDX-License-Identifier: Apache-2.0
//
// Goal: every process that asks gets the graph table, is notified once of the next change and not
// again, whatever the number of such processes, and after the daemon's death gets the table of the
// next one. Method: raw clients against the real daemon, which map the table themselves.

#include <agnocast/abi/graph_table.hpp>
#include <base/memory/mapping.hpp>
#include <region/graph_entry.hpp>
#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/node_process.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <chrono>
#include <memory>
#include <set>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

/// A client that watches, and its mapping of the table.
struct Watcher {
  explicit Watcher(const DaemonProcess& daemon) : node(daemon.socket_path()) {}

  std::uint64_t send() {
    wire::WatchGraph request{};
    request.table = table;
    request.seen = seen;
    return node.wire.send(Opcode::watch_graph, request);
  }
  /// Gets the answer to this request; `with_table`: it brings another table.
  void answered(std::uint64_t request, bool with_table) {
    Incoming packet = node.wire.answer_to(request);
    ASSERT_EQ(packet.opcode(), Opcode::graph_changed) << packet.refused_text();
    const auto body = packet.as<wire::GraphChanged>();
    ASSERT_EQ(packet.fds.size(), with_table ? 1u : 0u);
    EXPECT_EQ(body.table != table, with_table);
    if (with_table)
      mapping = std::move(
          Mapping::map(packet.fds[0].get(), abi::graph_bytes_max, Mapping::Access::read).value());
    table = body.table;
    seen = body.changes;
  }
  void ask(bool with_table) { answered(send(), with_table); }
  std::set<std::uint64_t> generations() const {
    std::set<std::uint64_t> all;
    const auto& header = *reinterpret_cast<const abi::GraphHeader*>(mapping.base());
    for (std::uint64_t i = 0; i < header.entry_high.load(); ++i) {
      const auto& entry =
          *reinterpret_cast<const abi::GraphEntry*>(mapping.base() + abi::graph_entry_offset(i));
      if (const auto one = region::load_entry(entry)) all.insert(one->generation);
    }
    return all;
  }

  CtlNode node;
  Mapping mapping;
  std::uint64_t table = 0, seen = 0;
};

TEST(DaemonGraph, TellsOnceOfTheNextChange) {
  DaemonProcess daemon;
  CtlNode node(daemon.socket_path());
  const auto first = node.publisher("/points");
  Watcher watcher(daemon);
  watcher.ask(true);
  EXPECT_EQ(watcher.generations(), std::set{first.generation});

  const std::uint64_t request = watcher.send();
  EXPECT_EQ(watcher.node.wire.poll(), std::nullopt) << "nothing has changed";
  const auto second = node.subscription("/points");
  watcher.answered(request, false);
  EXPECT_EQ(watcher.generations(), (std::set{first.generation, second.generation}));
  const auto third = node.publisher("/points");
  EXPECT_EQ(watcher.node.wire.poll(), std::nullopt) << "it has not asked again";
  watcher.ask(false);
  EXPECT_TRUE(watcher.generations().count(third.generation));
}

TEST(DaemonGraph, AFurtherRequestReplacesTheOneThatWaits) {
  DaemonProcess daemon;
  Watcher watcher(daemon);
  watcher.ask(true);
  watcher.send();
  const std::uint64_t request = watcher.send();
  CtlNode node(daemon.socket_path());
  node.publisher("/points");
  watcher.answered(request, false);
  EXPECT_EQ(watcher.node.wire.poll(), std::nullopt);
}

TEST(DaemonGraph, ADeathIsSeen) {
  DaemonProcess daemon;
  NodeProcess other(daemon.socket_path(), [](CtlNode& node) {
    node.publisher("/points");
    node.subscription("/points");
  });
  Watcher watcher(daemon);
  watcher.ask(true);
  EXPECT_EQ(watcher.generations().size(), 2u);
  const std::uint64_t request = watcher.send();
  other.kill();
  other.wait();
  watcher.answered(request, false);
  while (!watcher.generations().empty()) watcher.ask(false);
}

TEST(DaemonGraph, ServesMoreProcessesThanThereMayBeObservers) {
  DaemonProcess daemon;
  std::vector<std::unique_ptr<Watcher>> watchers;
  std::vector<std::uint64_t> requests;
  for (int i = 0; i < 40; ++i) {
    watchers.push_back(std::make_unique<Watcher>(daemon));
    watchers.back()->ask(true);
    requests.push_back(watchers.back()->send());
  }
  CtlNode node(daemon.socket_path());
  const auto publisher = node.publisher("/points");
  for (std::size_t i = 0; i < watchers.size(); ++i) {
    watchers[i]->answered(requests[i], false);
    EXPECT_EQ(watchers[i]->generations(), std::set{publisher.generation});
  }
}

TEST(DaemonGraph, TheNextDaemonHasATableOfItsOwn) {
  DaemonProcess daemon;
  CtlNode node(daemon.socket_path());
  const auto publisher = node.publisher("/points");
  Watcher watcher(daemon);
  watcher.ask(true);
  const std::uint64_t former = watcher.table;
  daemon.kill_worker();
  Watcher next(daemon);
  next.table = former;
  next.seen = watcher.seen;
  next.ask(true);
  EXPECT_EQ(next.generations(), std::set{publisher.generation});
  EXPECT_EQ(watcher.generations(), std::set{publisher.generation}) << "the former one stays";
}

TEST(DaemonGraph, ItsTableCannotBeWritten) {
  DaemonProcess daemon;
  CtlNode node(daemon.socket_path());
  const Incoming packet = node.wire.ask(Opcode::watch_graph, wire::WatchGraph{});
  ASSERT_EQ(packet.fds.size(), 1u);
  EXPECT_FALSE(Mapping::map(packet.fds[0].get(), abi::page_bytes, Mapping::Access::read_write));
}

TEST(DaemonGraph, IsForClients) {
  DaemonProcess daemon;
  WireClient nobody(daemon.socket_path());
  EXPECT_EQ(nobody.ask(Opcode::watch_graph, wire::WatchGraph{}).refused_code(),
            Errc::protocol_violation);
  WireClient observer(daemon.socket_path());
  wire::Observe hello{};
  hello.fingerprint = abi::fingerprint();
  EXPECT_EQ(observer.ask(Opcode::observe, hello).opcode(), Opcode::observed);
  EXPECT_EQ(observer.ask(Opcode::watch_graph, wire::WatchGraph{}).refused_code(),
            Errc::protocol_violation);
}

}  // namespace
}  // namespace agnocast::test
