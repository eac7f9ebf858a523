// SPDX-License-Identifier: Apache-2.0
//
// Goal: wherever an allocation of the daemon fails while it serves, it carries out or refuses the
// request, or ends the connection; the daemon lives, and its state is whole.
// Method: the real daemon with an operator new whose n-th call fails, or that one and every later
// one except from the reserve: n = 1, 2, 3, … until the request needs no more. Each time the test
// checks the daemon: a new process does everything that processes do. After each kind of request
// agnocast-ctl verify finds nothing, and a daemon that starts from the store has nothing to
// repair.

#include <tests/integration/daemon/raw_node.hpp>
#include <tests/support/memory/failing_memory.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/lowered_limit.hpp>

#include <agnocast/abi/observe.hpp>

#include <sys/mman.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

class ShortOfMemory : public testing::TestWithParam<bool> {
 protected:
  ShortOfMemory()
      : path_(directory_ + "/memory"),
        memory_(make()),
        daemon_({.environment = {"LD_PRELOAD=" AGNOCAST_TEST_FAILING_MEMORY,
                                 std::string(FailingMemory::variable) + "=" + path_}}) {}
  ~ShortOfMemory() override {
    ::munmap(memory_, sizeof(FailingMemory));
    remove_directory(directory_);
  }

  FailingMemory* make() const {
    const UniqueFd file(::open(path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    EXPECT_EQ(::ftruncate(file.get(), sizeof(FailingMemory)), 0);
    void* const at =
        ::mmap(nullptr, sizeof(FailingMemory), PROT_READ | PROT_WRITE, MAP_SHARED, file.get(), 0);
    EXPECT_NE(at, MAP_FAILED);
    return static_cast<FailingMemory*>(at);
  }

  /// Does everything that a process does, with another one.
  void probe() {
    RawNode a(daemon_), b(daemon_);
    const std::string topic = "/probe" + std::to_string(++probes_);
    EXPECT_EQ(a.wire.open_window(0).opcode(), Opcode::window_opened);
    const auto publisher = a.publisher(topic);
    const auto subscription = b.subscription(topic);
    EXPECT_EQ(b.wire.expect<wire::Announcement>(Opcode::announce).generation, publisher.generation);
    EXPECT_EQ(a.wire.expect<wire::Announcement>(Opcode::announce).generation,
              subscription.generation);
  }

  using Act = std::function<std::optional<Incoming>(RawNode&)>;
  /// Calls `act` once for each n.
  void sweep(const std::string& what, const std::function<void(RawNode&)>& prepare,
             const Act& act) {
    SCOPED_TRACE(what);
    const pid_t pid = daemon_.pid();
    unsigned done = 0, hung_up = 0;
    unsigned& refused = refused_ = 0;
    memory_->failures = 0;
    for (std::uint64_t n = 1; n < 2000 && !HasFailure(); ++n) {
      SCOPED_TRACE("allocation " + std::to_string(n));
      RawNode node(daemon_);
      prepare(node);
      memory_->count = 0;
      memory_->all_that_follow = GetParam() ? 1 : 0;
      memory_->first = n;
      const std::optional<Incoming> answer = act(node);
      // The daemon answers before it notifies others; it answers this request, or not, after that.
      wire::WindowRequest nonsense{};
      nonsense.window = abi::window_count_max;
      static_cast<void>(node.wire.try_ask(Opcode::open_window, nonsense));
      const bool is_over = memory_->count < n;
      memory_->first = 0;
      if (!answer) {
        ++hung_up;
      } else if (answer->opcode() != Opcode::refused) {
        ++done;
      } else {
        ++refused;
        EXPECT_EQ(answer->refused_code(), Errc::limit_reached) << answer->refused_text();
      }
      ASSERT_EQ(daemon_.pid(), pid) << daemon_.log();
      if (n % 8 == 0 || is_over) probe();
      if (is_over) break;
    }
    std::printf("%s: %u done, %u refused, %u hung up\n", what.c_str(), done, refused, hung_up);
    // Whether the reserve had to help depends on where the allocation failed; that one failed does
    // not.
    EXPECT_GT(memory_->failures, 0u);
    EXPECT_GT(done, 0u);
    const CtlResult verified = run_ctl(daemon_.socket_path(), {"verify"});
    EXPECT_EQ(verified.status, 0) << verified.out << verified.err;
    EXPECT_EQ(daemon_.pid(), pid);
    const std::size_t before = daemon_.log().size();
    ASSERT_TRUE(daemon_.wait_for_next(daemon_.kill_worker()));
    ASSERT_TRUE(eventually(
        [&] { return daemon_.log().substr(before).find("resumed") != std::string::npos; }));
    EXPECT_NE(daemon_.log().substr(before).find("board_words_repaired=0"), std::string::npos)
        << daemon_.log().substr(before);
    probe();
  }

  unsigned refused_ = 0;  // in the last sweep
  std::string directory_ = make_directory(), path_;
  FailingMemory* memory_;
  DaemonProcess daemon_;
  unsigned probes_ = 0;
};

void nothing(RawNode&) {}

TEST_P(ShortOfMemory, ConnectingAndHello) {
  sweep("hello", nothing, [&](RawNode&) -> std::optional<Incoming> {
    WireClient client(daemon_.socket_path());
    wire::Hello hello{};
    hello.fingerprint = abi::fingerprint();
    auto answer = client.try_ask(Opcode::hello, hello);
    if (answer) return answer;
    return std::nullopt;
  });
}

TEST_P(ShortOfMemory, WindowsExecutorsAndBlockedAddresses) {
  sweep("open_window", nothing, [](RawNode& node) {
    return node.wire.try_ask(Opcode::open_window, wire::WindowRequest{});
  });
  sweep("open_wait_set", nothing, [](RawNode& node) {
    return node.wire.try_ask(Opcode::open_wait_set, wire::WaitSetRequest{});
  });
  sweep("blocked", nothing, [](RawNode& node) {
    wire::Blocked range{};
    range.base = node.welcome.arena_base;
    range.bytes = abi::window_granule_bytes;
    range.what = wire_name("a test");
    // It has no answer; the next request has one.
    range.header = {Opcode::blocked, sizeof range, 1};
    static_cast<void>(node.wire.send_bytes(std::as_bytes(std::span(&range, 1))));
    return node.wire.try_ask(Opcode::open_window, wire::WindowRequest{});
  });
}

TEST_P(ShortOfMemory, PublishersForOthers) {
  std::unique_ptr<RawNode> reader;
  sweep(
      "create_publisher",
      [&](RawNode& node) {
        // The daemon may have ended its connection.
        reader = std::make_unique<RawNode>(daemon_);
        reader->subscription("/sweep");
        EXPECT_EQ(node.wire.open_window(0).opcode(), Opcode::window_opened);
      },
      [](RawNode& node) {
        return node.wire.try_ask(Opcode::create_publisher,
                                 WireClient::endpoint("/sweep", reliable));
      });
}

TEST_P(ShortOfMemory, SubscriptionsForOthers) {
  std::unique_ptr<RawNode> writer;
  sweep(
      "create_subscription",
      [&](RawNode& node) {
        writer = std::make_unique<RawNode>(daemon_);
        EXPECT_EQ(writer->wire.open_window(0).opcode(), Opcode::window_opened);
        writer->publisher("/sweep");
        EXPECT_EQ(node.wire.open_wait_set().opcode(), Opcode::wait_set_opened);
      },
      [](RawNode& node) {
        return node.wire.try_ask(Opcode::create_subscription,
                                 WireClient::endpoint("/sweep", reliable));
      });
}

TEST_P(ShortOfMemory, LeavingAndRejoining) {
  wire::EndpointCreated made{};
  std::unique_ptr<RawNode> reader;
  const auto join = [&](RawNode& node) {
    reader = std::make_unique<RawNode>(daemon_);
    reader->subscription("/sweep");
    EXPECT_EQ(node.wire.open_window(0).opcode(), Opcode::window_opened);
    made = node.publisher("/sweep");
  };
  const auto reference = [&] {
    wire::Reference body{};
    body.kind = Kind::publisher;
    body.topic = made.topic;
    body.index = made.index;
    body.generation = made.generation;
    return body;
  };
  sweep("leave", join,
        [&](RawNode& node) { return node.wire.try_ask(Opcode::leave, reference()); });
  EXPECT_EQ(refused_, 0u) << "it has left already: a refusal would leave its place behind";
  sweep("rejoin", join, [&](RawNode& node) {
    WireClient again(daemon_.socket_path());
    node.wire = WireClient(daemon_.socket_path());  // closes its own
    wire::Rejoin rejoin{};
    rejoin.fingerprint = abi::fingerprint();
    rejoin.incarnation = node.welcome.incarnation;
    rejoin.client = node.welcome.client;
    rejoin.client_generation = node.welcome.client_generation;
    return again.try_ask(Opcode::rejoin, rejoin);
  });
}

TEST_P(ShortOfMemory, StatementsOfWhatHasHappened) {
  const std::string reason = "it has happened already: a refusal would leave its place behind";
  std::unique_ptr<RawNode> writer;
  wire::EndpointCreated publisher{}, subscription{};
  int joined = 0;
  const auto join = [&](RawNode& node) {
    writer = std::make_unique<RawNode>(daemon_);
    // The daemon may still announce the publisher of the previous writer.
    const std::string topic = "/sweep" + std::to_string(++joined);
    EXPECT_EQ(writer->wire.open_window(0).opcode(), Opcode::window_opened);
    publisher = writer->publisher(topic);
    subscription = node.subscription(topic);
    EXPECT_EQ(node.wire.expect<wire::Announcement>(Opcode::announce).generation,
              publisher.generation);
  };
  const auto reference = [&] {
    wire::Reference body{};
    body.kind = Kind::subscription;
    body.topic = subscription.topic;
    body.index = subscription.index;
    body.generation = subscription.generation;
    return body;
  };
  sweep(
      "drained",
      [&](RawNode& node) {
        join(node);
        EXPECT_EQ(node.wire.ask(Opcode::leave, reference()).opcode(), Opcode::done);
      },
      [&](RawNode& node) { return node.wire.try_ask(Opcode::drained, reference()); });
  EXPECT_EQ(refused_, 0u) << reason;
  sweep("unlinked", join, [&](RawNode& node) {
    wire::Unlinked body{};
    body.kind = Kind::publisher;
    body.topic = publisher.topic;
    body.index = publisher.index;
    body.generation = publisher.generation;
    body.seen = node.wire.seen();
    constexpr std::uint64_t request = 1'000'000;
    body.header = {Opcode::unlinked, sizeof body, request};
    static_cast<void>(node.wire.send_bytes(std::as_bytes(std::span(&body, 1))));
    // It has no answer but a refusal. The next request has one, and is not refused either.
    auto answer = node.wire.try_ask(Opcode::leave, reference());
    while (node.wire.unasked_count() > 0) {
      Incoming before = node.wire.next();
      if (before.header().request == request) answer = std::move(before);
    }
    return answer;
  });
  EXPECT_EQ(refused_, 0u) << reason;
}

TEST_P(ShortOfMemory, Observers) {
  const auto look = [&](auto request, Opcode opcode, Opcode last) {
    return [this, request, opcode, last](RawNode&) -> std::optional<Incoming> {
      WireClient observer(daemon_.socket_path());
      wire::Observe observe{};
      observe.fingerprint = abi::fingerprint();
      auto seen = observer.try_ask(Opcode::observe, observe);
      if (!seen || seen->opcode() == Opcode::refused) return seen;
      auto answer = observer.try_ask(opcode, request);
      while (answer && answer->opcode() != last && answer->opcode() != Opcode::refused)
        answer = observer.try_receive();
      return answer;
    };
  };
  sweep("dump", nothing, look(wire::Dump{}, Opcode::dump, Opcode::dump_end));
  wire::ReadJournal journal{};
  journal.last = UINT64_MAX;
  journal.count = 100;
  sweep("read_journal", nothing, look(journal, Opcode::read_journal, Opcode::journal_end));
}

// In one round of the daemon's loop, without a request between them.
TEST_P(ShortOfMemory, ManyProcessesEndAtOnce) {
  constexpr std::size_t count = 150;
  const RawNode remaining(daemon_);
  std::vector<std::unique_ptr<RawNode>> nodes;
  std::vector<wire::EndpointCreated> publishers;
  for (std::size_t i = 0; i < count; ++i) {
    nodes.push_back(std::make_unique<RawNode>(daemon_));
    nodes.back()->subscription("/sweep" + std::to_string(i % 4));
    ASSERT_EQ(nodes.back()->wire.open_window(0).opcode(), Opcode::window_opened);
    publishers.push_back(nodes.back()->publisher("/sweep" + std::to_string(i % 4)));
  }
  const pid_t pid = daemon_.kill_worker(SIGSTOP);
  memory_->count = 0;
  memory_->all_that_follow = GetParam() ? 1 : 0;
  memory_->first = 1;
  nodes.clear();
  ASSERT_EQ(::kill(pid, SIGCONT), 0);
  EXPECT_TRUE(eventually([&] {
    const bool are_gone =
        std::none_of(publishers.begin(), publishers.end(), [&](const wire::EndpointCreated& each) {
          return abi::state_of(publisher_word(remaining.board, each.topic, each.index)) ==
                 abi::BoardState::active;
        });
    return are_gone || daemon_.pid() != pid;
  }));
  memory_->first = 0;
  ASSERT_EQ(daemon_.pid(), pid) << daemon_.log();
  probe();
}

INSTANTIATE_TEST_SUITE_P(Failing, ShortOfMemory, testing::Bool(),
                         [](const testing::TestParamInfo<bool>& one) {
                           return std::string(one.param ? "AllThatFollow" : "One");
                         });

// The same by the system itself: the limit of data addresses is what the daemon uses already.
TEST(DaemonMemory, RequestsAreRefusedWhileTheSystemGivesNone) {
  DaemonProcess daemon({.more_config = "[quota]\npublishers = \"unlimited\"\n"});
  const pid_t pid = daemon.pid();
  RawNode node(daemon);
  ASSERT_EQ(node.wire.open_window(0).opcode(), Opcode::window_opened);
  LoweredLimit limit(pid, RLIMIT_DATA, data_bytes(pid));
  std::uint64_t made = 0;
  bool refused = false;
  while (!refused && made < 20'000) {
    const Incoming answer = node.wire.create_publisher("/data" + std::to_string(made % 2000));
    ASSERT_FALSE(answer.bytes.empty());
    if (answer.opcode() == Opcode::endpoint_created) {
      ++made;
    } else {
      refused = true;
      EXPECT_EQ(answer.refused_code(), Errc::limit_reached) << answer.refused_text();
      EXPECT_EQ(answer.refused_text(), "agnocastd has no memory left");
    }
  }
  EXPECT_TRUE(refused);
  limit.lift();
  EXPECT_TRUE(eventually(
      [&] { return node.wire.create_publisher("/after").opcode() == Opcode::endpoint_created; }));
  EXPECT_EQ(daemon.pid(), pid);
  const CtlResult verified = run_ctl(daemon.socket_path(), {"verify"});
  EXPECT_EQ(verified.status, 0) << verified.out << verified.err;
}

}  // namespace
}  // namespace agnocast::test
