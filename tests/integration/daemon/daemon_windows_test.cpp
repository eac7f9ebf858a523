// SPDX-License-Identifier: Apache-2.0
//
// Goal: only its owner can bring a window, only to its own place, and a heap that a reader cannot
// map moves, with all affected processes notified. Method: as daemon_protocol_test.cpp.

#include <base/memory/memfd.hpp>
#include <tests/integration/daemon/raw_node.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

namespace agnocast::test {
namespace {

using wire::Opcode;
using Node = RawNode;

TEST(DaemonProtocol, AcceptsOnlyWindowsThatADaemonMade) {
  DaemonProcess former, daemon;
  Node owner(former);
  Incoming opened = owner.wire.open_window(0);
  ASSERT_EQ(opened.opcode(), Opcode::window_opened);
  const auto window = opened.as<wire::WindowOpened>();
  const int writer = opened.fds[0].get(), reader = opened.fds[1].get();

  Node node(daemon);
  EXPECT_EQ(node.wire.bring_window(window, reader).refused_code(), Errc::permission_denied)
      << "every reader of its owner has such a descriptor";
  EXPECT_EQ(node.wire.bring_window(window, node.fds[0].get()).refused_code(),
            Errc::permission_denied)
      << "a region";
  const UniqueFd own(::memfd_create("own", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  ASSERT_EQ(::ftruncate(own.get(), static_cast<off_t>(window.bytes)), 0);
  EXPECT_EQ(node.wire.bring_window(window, own.get()).refused_code(), Errc::permission_denied)
      << "its owner could truncate it under its readers";
  auto later = window;
  later.window = 1;
  EXPECT_EQ(node.wire.bring_window(later, writer).refused_code(), Errc::protocol_violation);

  EXPECT_EQ(node.wire.bring_window(window, writer).opcode(), Opcode::done);
  EXPECT_EQ(node.wire.bring_window(window, writer).opcode(), Opcode::done) << "it is already there";
  Node other(daemon);
  EXPECT_EQ(other.wire.bring_window(window, writer).refused_code(), Errc::arena_occupied);
  const auto next = node.wire.open_window(1).as<wire::WindowOpened>();
  EXPECT_NE(next.base, window.base);
  EXPECT_EQ(next.first, 0u) << "one window set";
}

TEST(DaemonProtocol, GivesABroughtWindowOnlyItsOwnPlace) {
  DaemonProcess former, daemon;
  Node owner(former), squatter(former);
  Incoming opened = owner.wire.open_window(0), another = squatter.wire.open_window(0);
  const auto window = opened.as<wire::WindowOpened>(), other = another.as<wire::WindowOpened>();
  ASSERT_NE(window.base, other.base);

  Node first(daemon);  // it comes before the owner does
  const int file = another.fds[0].get();
  auto claimed = other;
  for (const std::uint64_t base : {window.base, other.base + other.bytes, other.base + (2 << 20),
                                   std::uint64_t{1} << 21, std::uint64_t{0}}) {
    claimed.base = base;
    EXPECT_EQ(first.wire.bring_window(claimed, file).refused_code(), Errc::permission_denied);
  }
  EXPECT_EQ(first.wire.bring_window(other, file).opcode(), Opcode::done);
  claimed.window = 1;
  for (const std::uint64_t base : {window.base, other.base + other.bytes}) {
    claimed.base = base;
    EXPECT_EQ(first.wire.bring_window(claimed, file).refused_code(), Errc::permission_denied)
        << "the same once more";
  }
  claimed.base = other.base;
  EXPECT_EQ(first.wire.bring_window(claimed, file).refused_code(), Errc::arena_occupied);
  Node second(daemon);
  EXPECT_EQ(second.wire.bring_window(window, opened.fds[0].get()).opcode(), Opcode::done);
}

TEST(DaemonProtocol, AcceptsNoWindowThatAnotherUserMade) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  DaemonProcess former, daemon;
  Node owner(former), node(daemon);
  Incoming opened = owner.wire.open_window(0);
  const auto window = opened.as<wire::WindowOpened>();
  char name[64] = {};
  const std::string entry = "/proc/self/fd/" + std::to_string(opened.fds[0].get());
  ASSERT_GT(::readlink(entry.c_str(), name, sizeof name - 1), 0);
  std::string own_name = name;
  own_name = own_name.substr(7, own_name.size() - 7 - 10);  // "/memfd:", " (deleted)"
  const auto made_by = [&](uid_t user) {
    EXPECT_EQ(::seteuid(user), 0);
    auto fd = make_memfd(own_name.c_str(), window.bytes);
    EXPECT_EQ(::seteuid(0), 0);
    return std::move(fd.value());
  };
  const UniqueFd others = made_by(65534), ours = made_by(0);
  EXPECT_EQ(node.wire.bring_window(window, others.get()).refused_code(), Errc::permission_denied);
  EXPECT_EQ(node.wire.bring_window(window, ours.get()).opcode(), Opcode::done)
      << "bringing fails anyway, so the test proves nothing";
}

TEST(DaemonProtocol, AcceptsAWindowOnlyFromItsOwnersUser) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  DaemonProcess former, daemon;
  Node owner(former);
  Incoming opened = owner.wire.open_window(0);
  const auto window = opened.as<wire::WindowOpened>();
  const auto bring = [&] {
    WireClient client(daemon.socket_path());
    EXPECT_EQ(client.hello().opcode(), Opcode::welcome);
    return client.bring_window(window, opened.fds[0].get());
  };
  const pid_t pid = ::fork();  // it has kept a descriptor of another process
  if (pid == 0) {
    if (::setuid(65534) != 0) ::_exit(99);
    const bool is_refused = bring().refused_code() == Errc::permission_denied;
    ::_exit(is_refused && !testing::Test::HasFailure() ? 0 : 1);
  }
  int status = -1;
  ASSERT_EQ(::waitpid(pid, &status, 0), pid);
  EXPECT_EQ(status, 0);
  EXPECT_EQ(bring().opcode(), Opcode::done) << "bringing fails anyway, so the test proves nothing";
}

TEST(DaemonProtocol, AcceptsNoRegionAsAWindowWhateverTheirSizes) {
  const test::DaemonOptions options{
      .config =
          "[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"1GiB\"\n"
          "arena_bytes = \"64GiB\"\n" AGNOCAST_TEST_ARENA_BASE};
  DaemonProcess daemon(options);
  Node node(daemon);
  wire::WindowOpened window{};
  window.base = node.welcome.arena_base;
  window.bytes = node.welcome.client_region_bytes;
  ASSERT_EQ(window.bytes, std::uint64_t{1} << 30);
  ASSERT_EQ(node.fds.size(), 2u);
  EXPECT_EQ(node.wire.bring_window(window, node.fds[1].get()).refused_code(),
            Errc::permission_denied);
}

TEST(DaemonProtocol, AWindowOutsideTheArenaHasNoPlace) {
  const auto options = [](const char* base) {
    return test::DaemonOptions{
        .config = std::string("[daemon]\nsocket_mode = \"0666\"\n[heap]\n"
                              "window_bytes = \"64MiB\"\narena_bytes = \"4GiB\"\n") +
                  "arena_base = \"" + base + "\"\n"};
  };
  DaemonProcess former(options("64GiB")), daemon(options("128GiB"));
  Node owner(former), node(daemon);
  Incoming opened = owner.wire.open_window(0);
  const auto window = opened.as<wire::WindowOpened>();
  EXPECT_EQ(node.wire.bring_window(window, opened.fds[0].get()).refused_code(),
            Errc::arena_occupied);
}

std::uint64_t say_blocked(WireClient& client, std::uint64_t base, std::uint64_t bytes) {
  wire::Blocked body{};
  body.base = base;
  body.bytes = bytes;
  body.what = wire_name("a test");
  return client.send(Opcode::blocked, body);
}

TEST(DaemonProtocol, AsksAHeapToMoveForAReaderThatCannotMapIt) {
  DaemonProcess daemon;
  WireClient publisher(daemon.socket_path()), reader(daemon.socket_path());
  publisher.hello();
  const auto window = publisher.open_window(0).as<wire::WindowOpened>();
  EXPECT_EQ(window.first, 0u);
  ASSERT_EQ(publisher.create_publisher("/topic").opcode(), Opcode::endpoint_created);
  reader.hello();
  say_blocked(reader, window.base + window.bytes / 2, abi::window_granule_bytes);
  say_blocked(reader, window.base + window.bytes, window.bytes);
  reader.open_wait_set();
  ASSERT_EQ(reader.create_subscription("/topic").opcode(), Opcode::endpoint_created);

  const auto announced = reader.expect<wire::Announcement>(Opcode::announce);
  ASSERT_EQ(announced.window_count, 1u) << "it is announced like any other";
  const auto told = reader.expect<wire::Notice>(Opcode::notice);
  EXPECT_EQ(told.code, static_cast<std::uint32_t>(Errc::arena_occupied));
  EXPECT_NE(std::string(told.text.text).find("a test"), std::string::npos) << told.text.text;
  EXPECT_EQ(publisher.expect<wire::Notice>(Opcode::notice).code, told.code);
  EXPECT_EQ(publisher.expect<wire::MoveHeap>(Opcode::move_heap).window, 1u);

  const auto next = publisher.open_window(1).as<wire::WindowOpened>();
  EXPECT_EQ(next.first, 1u) << "a window set of its own";
  EXPECT_EQ(next.base, window.base + 2 * window.bytes) << "where the reader has mapped nothing";
  const auto again = publisher.open_window(1).as<wire::WindowOpened>();
  EXPECT_EQ(again.first, 1u);
  const auto more = publisher.open_window(2).as<wire::WindowOpened>();
  EXPECT_EQ(more.first, 1u) << "growth within the window set";
  EXPECT_EQ(reader.expect<wire::WindowAnnounced>(Opcode::window_announced).first, 1u);
  EXPECT_EQ(reader.expect<wire::WindowAnnounced>(Opcode::window_announced).first, 1u);
}

TEST(DaemonProtocol, TellsNoOtherUserWhatAProcessHasMapped) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root and another user";
  DaemonProcess daemon;
  WireClient publisher(daemon.socket_path());
  publisher.hello();
  const auto window = publisher.open_window(0).as<wire::WindowOpened>();
  ASSERT_EQ(publisher.create_publisher("/topic").opcode(), Opcode::endpoint_created);
  const auto notice_of = [](WireClient& client) {
    for (const Incoming& packet : client.drain()) {
      if (packet.opcode() == Opcode::notice)
        return std::string(packet.as<wire::Notice>().text.text);
    }
    return std::string();
  };
  EXPECT_EQ(in_other_user([&] {
              WireClient reader(daemon.socket_path());
              reader.hello();
              say_blocked(reader, window.base, abi::window_granule_bytes);
              reader.open_wait_set();
              reader.create_subscription("/topic");
              return notice_of(reader).find("a test") != std::string::npos ? 0 : 1;
            }),
            0);
  const std::string told = notice_of(publisher);
  EXPECT_NE(told.find("user " + std::to_string(other_uid)), std::string::npos) << told;
  EXPECT_NE(told.find(std::to_string(abi::window_granule_bytes) + " bytes"), std::string::npos)
      << told;
  EXPECT_EQ(told.find("a test"), std::string::npos) << told;
  EXPECT_NE(daemon.log().find("a test"), std::string::npos) << "the log has the whole text";
}

TEST(DaemonProtocol, NotifiesPublishersOnceOfARangeThatIsReportedRepeatedly) {
  DaemonProcess daemon;
  WireClient publisher(daemon.socket_path()), reader(daemon.socket_path());
  publisher.hello();
  const auto window = publisher.open_window(0).as<wire::WindowOpened>();
  ASSERT_EQ(publisher.create_publisher("/topic").opcode(), Opcode::endpoint_created);
  reader.hello();
  reader.open_wait_set();
  ASSERT_EQ(reader.create_subscription("/topic").opcode(), Opcode::endpoint_created);
  for (int i = 0; i < 100; ++i) say_blocked(reader, window.base, window.bytes);
  reader.drain();
  std::size_t notices = 0;
  for (const Incoming& packet : publisher.drain()) notices += packet.opcode() == Opcode::notice;
  EXPECT_EQ(notices, 1u);
}

TEST(DaemonProtocol, RefusesImpossibleBlockedRangesAndLetsNobodyBlockEverything) {
  DaemonProcess daemon;
  WireClient hostile(daemon.socket_path()), honest(daemon.socket_path());
  const auto arena = hostile.hello().as<wire::Welcome>();
  const auto refused = [&](std::uint64_t base, std::uint64_t bytes) {
    const std::uint64_t request = say_blocked(hostile, base, bytes);
    bool was = false;
    for (const Incoming& packet : hostile.drain())
      was = was || (packet.header().request == request && packet.opcode() == Opcode::refused);
    return was;
  };
  EXPECT_TRUE(refused(0, 4096));
  EXPECT_TRUE(refused(arena.arena_base, 0));
  EXPECT_TRUE(refused(arena.arena_base, arena.arena_bytes + 1));
  EXPECT_TRUE(refused(~std::uint64_t{0}, ~std::uint64_t{0}));
  EXPECT_FALSE(refused(arena.arena_base, arena.arena_bytes)) << "the whole arena";
  for (std::uint64_t i = 1; i < abi::blocked_count_max; ++i)
    EXPECT_FALSE(refused(arena.arena_base, i * abi::window_granule_bytes)) << i;
  EXPECT_TRUE(refused(arena.arena_base, 4096)) << "one too many";
  EXPECT_EQ(hostile.open_window(0).refused_code(), Errc::arena_occupied)
      << "it blocks only its own windows";
  honest.hello();
  EXPECT_EQ(honest.open_window(0).opcode(), Opcode::window_opened);
}

}  // namespace
}  // namespace agnocast::test
