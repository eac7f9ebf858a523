// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever is wrong, the user reads one sentence that names it (path, name and position,
// limit with key and value, types, library) and one that helps.
// Method: a program with a few lines (bad_input_node) against the real daemon, with the
// configuration or the environment that provokes each case. The test compares its whole output,
// with paths, process numbers and hashes replaced by words.

#include <agnocast/abi/fingerprint.hpp>
#include <tests/support/machine/raised_limits.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/shell.hpp>
#include <tests/support/wire/listen_at.hpp>
#include <tests/support/wire/proxy_without_descriptors.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <future>
#include <regex>
#include <string>
#include <thread>

namespace agnocast::test {
namespace {

constexpr const char* small_windows =
    "[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"64GiB\"\n";

/// Runs the node with these arguments; `environment` beside AGNOCAST_SOCKET.
ShellResult node(const std::string& socket, const std::string& arguments,
                 const std::string& environment = "LD_PRELOAD=" AGNOCAST_HOOK) {
  const std::string command = "timeout 60 env AGNOCAST_SOCKET=" + socket + " " + environment +
                              " " AGNOCAST_NODE " " + arguments + " 2>&1";
  return run_in_shell(command);
}
ShellResult node(const DaemonProcess& daemon, const std::string& arguments,
                 const std::string& environment = "LD_PRELOAD=" AGNOCAST_HOOK) {
  return node(daemon.socket_path(), arguments, environment);
}

std::string replaced(const std::string& text, const std::string& pattern, const char* word) {
  return std::regex_replace(text, std::regex(pattern), word);
}

/// Expects status 1 and exactly these two lines, spelt "program: what: why" and "hint: command".
void expect_refusal(const ShellResult& outcome, const std::string& why, Errc code) {
  EXPECT_EQ(outcome.status, 1);
  EXPECT_EQ(outcome.text, std::string("node: ") + sentence_of(code) + ": " + why +
                              "\nhint: " + remedy_of(code) + "\n");
}
/// The same for publish, which answers with a code.
void expect_unpublished(const ShellResult& outcome, Errc code) {
  EXPECT_EQ(outcome.status, 1);
  EXPECT_EQ(outcome.text, std::string("node: publish: ") + sentence_of(code) +
                              "\nhint: " + remedy_of(code) + "\n");
}

// --- the hook

TEST(BadInput, AMissingHookIsNamedWithThePreloadedLibraries) {
  DaemonProcess daemon;
  expect_refusal(node(daemon, "pub", ""), "LD_PRELOAD is not set", Errc::hook_missing);
  expect_refusal(node(daemon, "pub", "LD_PRELOAD=" AGNOCAST_OTHER_MALLOC),
                 "LD_PRELOAD is \"" AGNOCAST_OTHER_MALLOC "\", which did not load it",
                 Errc::hook_missing);
}

TEST(BadInput, AnIneffectiveHookIsNamedWithTheLibraryInItsPlace) {
  DaemonProcess daemon;
  const char* const why = "malloc comes from " AGNOCAST_OTHER_MALLOC ", not from " AGNOCAST_HOOK;
  const char* const preload = "LD_PRELOAD=" AGNOCAST_OTHER_MALLOC ":" AGNOCAST_HOOK;
  const ShellResult once = node(daemon, "pub", preload);
  expect_refusal(once, why, Errc::hook_ineffective);
  EXPECT_EQ(node(daemon, "insist pub", preload).text, once.text + once.text)
      << "the next attempt gets the same text";
}

// --- the daemon

TEST(BadInput, ADaemonThatDoesNotRunIsNamedWithItsSocket) {
  expect_refusal(node("/nonexistent/agnocastd.sock", "sub"),
                 "connecting to /nonexistent/agnocastd.sock: No such file or directory",
                 Errc::daemon_not_running);
  DaemonProcess daemon;
  const std::string socket = daemon.socket_path();
  daemon.kill();
  expect_refusal(node(socket, "try_pub"), "connecting to " + socket + ": Connection refused",
                 Errc::daemon_not_running);
}

TEST(BadInput, AStoppedDaemonIsWaitedForAndNamed) {
  DaemonProcess daemon;
  ASSERT_EQ(::kill(daemon.pid(), SIGSTOP), 0);
  const ShellResult outcome = node(daemon, "sub");
  ::kill(daemon.pid(), SIGCONT);
  expect_refusal(outcome, daemon.socket_path() + ": no answer from agnocastd within 5 s",
                 Errc::daemon_not_running);
}

TEST(BadInput, NoPermissionIsNamedWithTheSocketOrTheRule) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to become another user";
  DaemonProcess closed({.config = "[daemon]\nsocket_mode = \"0600\"\n"});
  expect_refusal(node(closed, "uid=65534 sub"),
                 "connecting to " + closed.socket_path() + ": Permission denied",
                 Errc::permission_denied);
  DaemonProcess ruled({.config = std::string(small_windows) +
                                 "[[access]]\ntopic = \"/secret/**\"\npublish = [\"uid:0\"]\n"
                                 "subscribe = []\n"});
  expect_refusal(node(ruled, "uid=65534 topic=/secret/plan pub"),
                 "user 65534 may not publish on /secret/plan (rule in line 6)",
                 Errc::access_denied);
  expect_refusal(node(ruled, "topic=/secret/plan sub"),
                 "user 0 may not subscribe to /secret/plan (rule in line 6)", Errc::access_denied);
  EXPECT_EQ(node(ruled, "topic=/secret/plan pub").status, 0);
}

/// Stands between a library and the daemon and changes the library's fingerprint, so that it looks
/// like a library of another build.
TEST(BadInput, BothSidesReportAnotherLayout) {
  DaemonProcess daemon;
  const std::string path = daemon.directory() + "/between.sock";
  auto listener = test::listen_at(path);
  ASSERT_TRUE(listener);
  std::thread between([&] {
    pollfd waiting{listener->fd(), POLLIN, 0};
    ASSERT_EQ(::poll(&waiting, 1, 20000), 1);
    auto library = listener->accept();
    ASSERT_TRUE(library && *library);
    pollfd readable{(*library)->fd(), POLLIN, 0};  // accepted sockets do not block
    ASSERT_EQ(::poll(&readable, 1, 20000), 1);
    std::array<std::byte, wire::packet_bytes_max> buffer;
    const auto said = (*library)->receive(buffer, Wait::yes);
    ASSERT_TRUE(said);
    wire::Hello hello{};
    ASSERT_EQ(said->bytes, sizeof hello);
    std::memcpy(static_cast<void*>(&hello), buffer.data(), sizeof hello);
    hello.fingerprint = 0x1234;
    auto server = PacketSocket::connect(daemon.socket_path());
    ASSERT_TRUE(server);
    ASSERT_TRUE(server->send(std::as_bytes(std::span(&hello, 1))));
    const auto answer = server->receive(buffer, Wait::yes);
    ASSERT_TRUE(answer);
    ASSERT_TRUE((*library)->send(std::span(buffer).first(answer->bytes)));
  });
  const ShellResult outcome = node(path, "sub");
  between.join();
  char ours[32];
  std::snprintf(ours, sizeof ours, "0x%016jx", std::uintmax_t{abi::fingerprint()});
  const std::string why =
      "the library has layout 0x0000000000001234, the daemon has layout " + std::string(ours);
  expect_refusal(outcome, why, Errc::layout_mismatch);
  EXPECT_TRUE(daemon.wait_for_log(why));
}

TEST(BadInput, AnAnswerWithoutItsDescriptorsIsDistinguishedFromALimitOfOpenFiles) {
  DaemonProcess daemon;
  const std::string path = daemon.directory() + "/proxy.sock";
  {
    const ProxyWithoutDescriptors proxy(path, daemon.socket_path());
    expect_refusal(node(path, "sub"), "the welcome from agnocastd", Errc::descriptors_withheld);
  }
  // Enough for the program, its connection and one of the welcome's two.
  expect_refusal(node(daemon, "sub", "LD_PRELOAD=" AGNOCAST_HOOK " prlimit --nofile=7"),
                 "the welcome from agnocastd: Too many open files", Errc::os_failure);
}

// --- requests

TEST(BadInput, ATypeMismatchIsReportedToBothSidesAndInTheLog) {
  DaemonProcess daemon;
  WireClient running(daemon.socket_path());
  ASSERT_EQ(running.hello().opcode(), wire::Opcode::welcome);
  auto wanted = WireClient::endpoint("/typed", {1, false, true, false, false}, "test/Other");
  wanted.layout_hash = 0xabc;
  ASSERT_EQ(running.ask(wire::Opcode::create_publisher, wanted).opcode(),
            wire::Opcode::endpoint_created);
  const auto general = [](const std::string& text) {
    return replaced(replaced(text, "process [0-9]+", "process PID"),
                    "test/Text \\(layout 0x[0-9a-f]{16}\\)", "test/Text (layout HASH)");
  };
  ShellResult outcome = node(daemon, "topic=/typed sub");
  const std::string why =
      "test/Text (layout HASH) is asked for by process PID, "
      "test/Other (layout 0x0000000000000abc) is the type of /typed";
  outcome.text = general(outcome.text);
  expect_refusal(outcome, why, Errc::type_mismatch);
  const auto notice = running.expect<wire::Notice>(wire::Opcode::notice);
  EXPECT_EQ(static_cast<Errc>(notice.code), Errc::type_mismatch);
  EXPECT_EQ(general(notice.text.text), why);
  EXPECT_NE(general(daemon.log()).find("code=type_mismatch errno=0 why=\"" + why),
            std::string::npos)
      << daemon.log();
}

TEST(BadInput, TheSameTypeWithAnotherLayoutIsNamedWithBothHashes) {
  DaemonProcess daemon;
  ShellResult outcome = node(daemon, "topic=/typed pub type=wide pub");
  std::smatch hashes;
  ASSERT_TRUE(std::regex_search(outcome.text, hashes,
                                std::regex("layout (0x[0-9a-f]{16}).*layout (0x[0-9a-f]{16})")))
      << outcome.text;
  EXPECT_NE(hashes[1], hashes[2]);
  outcome.text =
      replaced(replaced(outcome.text, "0x[0-9a-f]{16}", "HASH"), "process [0-9]+", "process PID");
  expect_refusal(outcome,
                 "test/Text (layout HASH) is asked for by process PID, "
                 "test/Text (layout HASH) is the type of /typed",
                 Errc::type_mismatch);
}

TEST(BadInput, DepthsAreNamedWithTheirLimit) {
  DaemonProcess daemon({.config = std::string(small_windows) + "[limits]\ndepth_max = 20\n"});
  for (const char* endpoint : {"pub", "sub", "try_pub"}) {
    const auto with = [&](const char* depth) {
      return node(daemon, std::string("depth=") + depth + " " + endpoint);
    };
    expect_refusal(with("0"), "depth 0 is outside 1 to 1000", Errc::depth_refused);
    expect_refusal(with("18446744073709551615"), "depth 18446744073709551615 is outside 1 to 1000",
                   Errc::depth_refused);
    expect_refusal(with("4294967297"), "depth 4294967297 is outside 1 to 1000",
                   Errc::depth_refused);
    expect_refusal(with("21"), "[limits] depth_max is 20, depth 21 is asked for",
                   Errc::depth_refused);
    EXPECT_EQ(with("20").text, "");
  }
}

TEST(BadInput, InvalidTopicNamesAreNamedWithThePosition) {
  DaemonProcess daemon;
  const std::string long_name(300, 'a');
  const struct {
    std::string name, why;
  } rows[] = {
      {"''", "\"\": the name is empty, at character 1"},
      {"/a//b", "\"/a//b\": two slashes in a row, at character 4"},
      {"/a/", "\"/a/\": a slash cannot be the last character, at character 3"},
      {"2nd", "\"2nd\": a digit cannot be the first character of a token, at character 1"},
      {"'a b'", "\"a b\": a space is not allowed, at character 2"},
      {"'a-b'",
       "\"a-b\": only letters, digits, underscores and slashes are allowed, at character 2"},
      {"'a~'", "\"a~\": a tilde can only be the first character, at character 2"},
      {"'~a'", "\"~a\": a slash has to follow the tilde, at character 2"},
      {"'{node}/x'", "\"{node}/x\": substitutions in braces are not supported, at character 1"},
      {"'a\n'",
       "\"a\\n\": only letters, digits, underscores and slashes are allowed, at character 2"},
  };
  for (const auto& row : rows) {
    for (const char* endpoint : {"pub", "sub"})
      expect_refusal(node(daemon, "topic=" + row.name + " " + endpoint), "topic " + row.why,
                     Errc::invalid_name);
  }
  expect_refusal(node(daemon, "topic=" + long_name + " sub"),
                 "topic \"" + long_name.substr(0, 256) +
                     "...\": the name is longer than 255 characters, at character 256",
                 Errc::invalid_name);
}

TEST(BadInput, ADomainThatIsNoNumberIsNamed) {
  DaemonProcess daemon;
  for (const char* domain : {"seven", "7x", "-1", "99999999999999999999"}) {
    expect_refusal(node(daemon, "sub", std::string("ROS_DOMAIN_ID=") + domain),
                   std::string("ROS_DOMAIN_ID is \"") + domain + "\", which is not a number",
                   Errc::invalid_argument);
  }
  EXPECT_EQ(node(daemon, "sub", "ROS_DOMAIN_ID=7").text, "");
}

// --- limits

TEST(BadInput, QuotasAreNamedWithKeyValueAndUse) {
  DaemonProcess daemon({.config = std::string(small_windows) +
                                  "[quota]\npublishers = 2\nsubscriptions = 1\nclients = 2\n"
                                  "heap_bytes = \"64MiB\"\n"});
  expect_refusal(node(daemon, "pub pub pub"),
                 "[quota] publishers is 2, this user has 2 and asks for 1 more",
                 Errc::quota_exceeded);
  expect_refusal(node(daemon, "sub topic=/other sub"),
                 "[quota] subscriptions is 1, this user has 1 and asks for 1 more",
                 Errc::quota_exceeded);
  const WireClient silent(daemon.socket_path());
  WireClient greeted(daemon.socket_path());
  ASSERT_EQ(greeted.hello().opcode(), wire::Opcode::welcome);
  expect_refusal(node(daemon, "sub"), "[quota] clients is 2, this user has as many",
                 Errc::quota_exceeded);
  EXPECT_TRUE(daemon.wait_for_log("[quota] clients"));
}

TEST(BadInput, TheHeapQuotaIsNamedWithKeyValueAndUse) {
  DaemonProcess daemon(
      {.config = std::string(small_windows) + "[quota]\nheap_bytes = \"64MiB\"\n"});
  WireClient other(daemon.socket_path());
  ASSERT_EQ(other.hello().opcode(), wire::Opcode::welcome);
  ASSERT_EQ(other.open_window(0).opcode(), wire::Opcode::window_opened);
  expect_refusal(
      node(daemon, "pub"),
      "[quota] heap_bytes is 67108864, this user has 67108864 and asks for 67108864 more",
      Errc::quota_exceeded);
}

TEST(BadInput, FullTablesAreNamedWithTheirKey) {
  DaemonProcess daemon(
      {.config = std::string(small_windows) +
                 "[limits]\npublishers_per_topic = 1\nsubscriptions_per_topic = 1\n"
                 "topics = 1\nclients = 2\n"});
  expect_refusal(node(daemon, "pub pub"), "[limits] publishers_per_topic is 1, as many are there",
                 Errc::limit_reached);
  expect_refusal(node(daemon, "sub sub"),
                 "[limits] subscriptions_per_topic is 1, as many are there", Errc::limit_reached);
  expect_refusal(node(daemon, "sub topic=/other sub"), "[limits] topics is 1, as many are there",
                 Errc::limit_reached);
}

TEST(BadInput, AnExhaustedWindowIsNamed) {
  DaemonProcess one({.config = std::string(small_windows) + "windows_per_process = 1\n"});
  expect_unpublished(node(one, "depth=1 pub full=4000000"), Errc::window_exhausted);
  EXPECT_TRUE(one.wait_for_log("[heap] windows_per_process is 1, this process has as many"));
}

TEST(BadInput, AnOccupiedArenaIsNamedWithTheMappingThere) {
  // One window, which overlaps an occupied page.
  DaemonProcess daemon({.config = "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"64MiB\"\n"
                                  "arena_base = 0x300000000000\n"});
  expect_refusal(node(daemon, "occupy=0x300000200000 sub pub"),
                 "no window is left that this process can map; it has 300000200000-300000201000 "
                 "r--p 00000000 00:00 0",
                 Errc::arena_occupied);
}

TEST(BadInput, AnArenaWithoutFreeRangesIsNamedWithTheMappingsThere) {
  DaemonProcess daemon({.config = "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"64MiB\"\n"
                                  "arena_base = 0x300000000000\n"});
  expect_refusal(node(daemon, "occupied=67108864 occupy=0x300000000000 sub"),
                 "0x300000000000-0x300004000000 has 300000000000-300004000000 r--p 00000000 "
                 "00:00 0",
                 Errc::arena_occupied);
}

// --- loans

TEST(BadInput, AMovedFromOrForeignLoanIsRefused) {
  DaemonProcess daemon;
  for (const char* misuse : {"empty", "moved", "twice", "foreign"})
    expect_unpublished(node(daemon, misuse), Errc::loan_invalid);
}

TEST(BadInput, AForkedChildGetsAnErrorAndTheParentsLoanStaysValid) {
  DaemonProcess daemon;
  const ShellResult outcome = node(daemon, "pub fork");
  EXPECT_EQ(outcome.status, 0);
  const std::string sentence = sentence_of(Errc::shut_down), remedy = remedy_of(Errc::shut_down);
  EXPECT_EQ(
      outcome.text,
      "node: publish: " + sentence + "\nhint: " + remedy + "\nnode: " + sentence +
          ": this process was forked by one that uses agnocast, and has not called exec\nhint: " +
          remedy + "\nthe parent's loan: published\n");
}

// --- limits of the process

// The arena alone is 64 GiB of addresses, and the process may lock 8 MiB: reserved addresses do
// not count.
TEST(BadInput, ASubscriberThatLocksItsMemoryUnderALimitWorks) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to drop the right to lock any amount";
  DaemonProcess daemon({.config = small_windows, .uid = {}, .arguments = {"--log-level", "debug"}});
  auto subscriber = std::async(std::launch::async, [&] {
    return node(daemon, "memlock=8388608 uid=65534 lock sub take=1000000", "");
  });
  EXPECT_TRUE(daemon.wait_for_log("endpoint created kind=subscription"));
  EXPECT_EQ(node(daemon, "pub publish=1000000").text, "published, 0 bytes adopted\n");
  const ShellResult outcome = subscriber.get();
  EXPECT_EQ(outcome.status, 0);
  EXPECT_EQ(outcome.text, "received 1000000 bytes\n");
}

// Reserved addresses around an occupied range do not count either.
TEST(BadInput, ASubscriberThatLocksItsMemoryAndHasMappingsInTheArenaWorks) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to drop the right to lock any amount";
  DaemonProcess daemon({.config = std::string(small_windows) + "arena_base = 0x300000000000\n",
                        .uid = {},
                        .arguments = {"--log-level", "debug"}});
  auto subscriber = std::async(std::launch::async, [&] {
    return node(daemon,
                "occupy=0x300000200000 occupy=0x300100000000 memlock=8388608 uid=65534 lock sub "
                "take=1000000",
                "");
  });
  EXPECT_TRUE(daemon.wait_for_log("endpoint created kind=subscription"));
  EXPECT_EQ(node(daemon, "pub publish=1000000").text, "published, 0 bytes adopted\n");
  const ShellResult outcome = subscriber.get();
  EXPECT_EQ(outcome.status, 0);
  EXPECT_EQ(outcome.text, "received 1000000 bytes\n");
}

TEST(BadInput, APublisherThatLocksItsMemoryUnderALimitWorks) {
  rlimit limit{};
  ::getrlimit(RLIMIT_MEMLOCK, &limit);
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to drop the right to lock any amount";
  if (limit.rlim_max < (64u << 20) && !may_raise_limits())
    GTEST_SKIP() << "needs a hard limit of 64 MiB of locked memory, or CAP_SYS_RESOURCE";
  DaemonProcess daemon;
  const ShellResult outcome =
      node(daemon, "memlock=67108864 uid=65534 lock sub pub publish=5000000 take=5000000");
  EXPECT_EQ(outcome.status, 0);
  EXPECT_EQ(outcome.text, "published, 0 bytes adopted\nreceived 5000000 bytes\n");
}

TEST(BadInput, ALockLimitThatIsTooSmallIsNamedWithItsValueAndTheNeed) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root to drop the right to lock any amount";
  DaemonProcess daemon;
  ShellResult outcome = node(daemon, "memlock=8388608 uid=65534 lock pub");
  outcome.text = replaced(outcome.text, "[0-9]+ are locked", "N are locked");
  expect_refusal(outcome,
                 "RLIMIT_MEMLOCK is 8388608 bytes, N are locked and 27262976 more are needed",
                 Errc::lock_limit);
  outcome = node(daemon, "memlock=262144 uid=65534 lock sub");
  outcome.text = replaced(outcome.text, "[0-9]+ are locked and [0-9]+", "N are locked and N");
  expect_refusal(outcome, "RLIMIT_MEMLOCK is 262144 bytes, N are locked and N more are needed",
                 Errc::lock_limit);
}

// A small address space, by ulimit -v: with an arena that fits, just enough is enough, and every
// failure names the limit of addresses, with its remedy.
TEST(BadInput, AnyLimitOfAddressesIsEnoughOrNamed) {
  DaemonProcess daemon({.config = "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"256MiB\"\n"});
  constexpr std::uint64_t mib = 1 << 20;
  std::uint64_t too_small = 128 * mib, enough = 4096 * mib;
  const auto run = [&](std::uint64_t limit) {
    return node(daemon,
                "addresses=" + std::to_string(limit) + " sub pub publish=5000000 take=5000000");
  };
  ASSERT_EQ(run(enough).text, "published, 0 bytes adopted\nreceived 5000000 bytes\n");
  while (enough - too_small > mib) {
    const std::uint64_t limit = (enough + too_small) / 2;
    ShellResult outcome = run(limit);
    (outcome.status == 0 ? enough : too_small) = limit;
    if (outcome.status == 0) continue;
    outcome.text = replaced(outcome.text, "[0-9]+ more", "N more");
    expect_refusal(outcome, "RLIMIT_AS is " + std::to_string(limit) + " bytes, N more are needed",
                   Errc::address_limit);
  }
  std::printf("a publisher and subscriber in one process, arena 256 MiB: %ju MiB of addresses\n",
              std::uintmax_t{enough / mib});
}

TEST(BadInput, ALimitOfAddressesIsNamedWithItsValueAndTheNeed) {
  DaemonProcess daemon;
  expect_refusal(node(daemon, "addresses=4294967296 sub"),
                 "RLIMIT_AS is 4294967296 bytes, 68719476736 more are needed", Errc::address_limit);
}

}  // namespace
}  // namespace agnocast::test
