// SPDX-License-Identifier: Apache-2.0
//
// Goal: each mistake in a configuration is reported with its position and a remedy, and a printed
// configuration reads back unchanged. Method: a table of mistakes with exact texts, the sample
// file, and random configurations (seeded). User and group names are the test's own.

#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/unit/daemon/config/config_text.hpp>

#include <gmock/gmock.h>

#include <sys/stat.h>

#include <algorithm>
#include <fstream>
#include <random>
#include <sstream>
#include <string>

namespace agnocast::daemon {
namespace {

using testing::ElementsAre;
using testing::EndsWith;
using testing::StartsWith;

std::string contents(const std::string& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

TEST(Config, EmptyFileMeansDefaults) {
  EXPECT_EQ(parse("").value(), Config{});
  EXPECT_EQ(parse("[daemon]\n[heap]\n[limits]\n[quota]\n").value(), Config{});
}

TEST(Config, SampleFileEqualsThePrintedDefaults) {
  const std::string file = AGNOCAST_SOURCE_DIR "/systemd/agnocastd.toml";
  EXPECT_EQ(contents(file), to_toml(Config{}))
      << "print it again: agnocastd --print-config > systemd/agnocastd.toml";
  const auto config = load_config(file, names);
  ASSERT_TRUE(config) << config.error().front().text();
  EXPECT_EQ(*config, Config{});
}

// Long because it has every key, in the text and in the result.
TEST(Config, EveryKeyArrives) {
  const auto config = parse(R"(
[daemon]
socket = "/run/x/y.sock"
runtime_directory = "/run/x"
socket_mode = 0o666
socket_group = "sensors"
log_level = "debug"
[heap]
window_bytes = "1 GiB"
windows_per_process = 3
arena_base = 0x300000000000
arena_bytes = "4TiB"
[limits]
depth_max = 10
slots_per_publisher = 64
clients = 11
topics = 12
publishers_per_topic = 13
subscriptions_per_topic = 14
wide_topics = ["/a", "/b/c"]
[quota]
clients = 15
topics = 19
publishers = 0
subscriptions = 17
heap_bytes = 2147483648
held_messages = 18
wait_sets = "unlimited"
callback_groups = 21
callback_threads = 0
queued_bytes = "2MiB"
queued_seconds = 3
dumps_per_second = 4
publishers_per_topic = 20
subscriptions_per_topic = "unlimited"
[[access]]
topic = "/lidar/**"
domain = 7
publish = ["user:alice", "uid:0"]
subscribe = ["group:sensors", "gid:4294967294", "*"]
[[access]]
topic = "**"
publish = []
)");
  ASSERT_TRUE(config) << config.error().front().text();
  EXPECT_EQ(config->daemon.socket, "/run/x/y.sock");
  EXPECT_EQ(config->daemon.runtime_directory, "/run/x");
  EXPECT_EQ(config->daemon.socket_mode, 0666U);
  EXPECT_EQ(config->daemon.socket_group, "sensors");
  EXPECT_EQ(config->daemon.log_level, LogLevel::debug);
  EXPECT_EQ(config->heap.window_bytes, std::uint64_t{1} << 30);
  EXPECT_EQ(config->heap.windows_per_process, 3U);
  EXPECT_EQ(config->heap.arena_base, 0x3000'0000'0000U);
  EXPECT_EQ(config->heap.arena_bytes, std::uint64_t{1} << 42);
  EXPECT_EQ(config->limits.depth_max, 10U);
  EXPECT_EQ(config->limits.slots_per_publisher, 64U);
  EXPECT_EQ(config->limits.clients, 11U);
  EXPECT_EQ(config->limits.topics, 12U);
  EXPECT_EQ(config->limits.publishers_per_topic, 13U);
  EXPECT_EQ(config->limits.subscriptions_per_topic, 14U);
  EXPECT_EQ(config->limits.wide_topics, (std::vector<std::string>{"/a", "/b/c"}));
  EXPECT_EQ(config->quota.clients, 15U);
  EXPECT_EQ(config->quota.topics, 19U);
  EXPECT_EQ(config->quota.publishers, 0U);
  EXPECT_EQ(config->quota.subscriptions, 17U);
  EXPECT_EQ(config->quota.heap_bytes, std::uint64_t{1} << 31);
  EXPECT_EQ(config->quota.held_messages, 18U);
  EXPECT_EQ(config->quota.wait_sets, unlimited);
  EXPECT_EQ(config->quota.callback_groups, 21U);
  EXPECT_EQ(config->quota.callback_threads, 0U);
  EXPECT_EQ(config->quota.queued_bytes, std::uint64_t{2} << 20);
  EXPECT_EQ(config->quota.queued_seconds, 3U);
  EXPECT_EQ(config->quota.dumps_per_second, 4U);
  EXPECT_EQ(config->quota.publishers_per_topic, 20U);
  EXPECT_EQ(config->quota.subscriptions_per_topic, unlimited);
  ASSERT_EQ(config->access.size(), 2U);
  const AccessRule& first = config->access[0];
  EXPECT_EQ(first.topic, "/lidar/**");
  EXPECT_EQ(first.domain, 7U);
  EXPECT_EQ(first.line, 36U);
  EXPECT_THAT(first.publish->uids, ElementsAre(1000U, 0U));
  EXPECT_FALSE(first.publish->everybody);
  EXPECT_THAT(first.subscribe->gids, ElementsAre(50U, 4294967294U));
  EXPECT_TRUE(first.subscribe->everybody);
  EXPECT_TRUE(config->access[1].publish);
  EXPECT_FALSE(config->access[1].subscribe);
  EXPECT_FALSE(config->access[1].publish->contains(0, {}));
}

// Long because it is the table of all mistakes.
TEST(Config, MistakesAreReportedWithPositionAndRemedy) {
  const std::string long_path = "/" + std::string(107, 'x');
  const struct {
    std::string text;
    std::string errors;
  } rows[] = {
      // unknown
      {"[limits]\ndepht_max = 5\n",
       "f.toml:2:1: limits.depht_max: unknown key; did you mean \"depth_max\"?"},
      {"[heap]\n  colour = 5\n",
       "f.toml:2:3: heap.colour: unknown key; known here: window_bytes, windows_per_process, "
       "arena_base, arena_bytes"},
      {"[limit]\n", "f.toml:1:2: limit: unknown key; did you mean \"limits\"?"},
      {"[network]\n",
       "f.toml:1:2: network: unknown key; known here: daemon, heap, limits, quota, access, "
       "thread"},
      {"topics = 5\n", "f.toml:1:1: topics: is outside of its section; write it below [limits]"},
      {"[daemon]\n\"a\\nb\" = 1\n",
       "f.toml:2:1: daemon.a\\nb: unknown key; known here: socket, runtime_directory, socket_mode, "
       "socket_group, log_level, watchdog_seconds"},
      // wrong type
      {"limits = 5\n",
       "f.toml:1:10: limits: an integer is not allowed here; write a section: [limits]"},
      {"[limits]\ntopics = \"5\"\n",
       "f.toml:2:10: limits.topics: \"5\" is not a number; write an integer"},
      {"[limits]\ntopics = 5.5\n",
       "f.toml:2:10: limits.topics: a number with a fraction is not allowed here; write an "
       "integer"},
      {"[limits]\ntopics = true\n",
       "f.toml:2:10: limits.topics: true or false is not allowed here; write an integer"},
      {"[limits]\ntopics = [1]\n",
       "f.toml:2:10: limits.topics: a list is not allowed here; write an integer"},
      {"[limits]\ntopics = 2026-01-01\n",
       "f.toml:2:10: limits.topics: a date or time is not allowed here; write an integer"},
      {"[daemon]\nsocket = 5\n",
       "f.toml:2:10: daemon.socket: an integer is not allowed here; write a path, or \"auto\""},
      {"[daemon]\nlog_level = 7\n",
       "f.toml:2:13: daemon.log_level: an integer is not allowed here; write one of error, "
       "warning, "
       "notice, info, debug"},
      {"[quota]\nclients = \"many\"\n",
       "f.toml:2:11: quota.clients: \"many\" is not a number; write an integer, or \"unlimited\""},
      // out of range, or without meaning for the key
      {"[limits]\ndepth_max = 1001\n",
       "f.toml:2:13: limits.depth_max: 1001 is out of range; use 1 to 1000"},
      {"[limits]\ndepth_max = 0\n",
       "f.toml:2:13: limits.depth_max: 0 is out of range; use 1 to 1000"},
      {"[limits]\nclients = -1\n",
       "f.toml:2:11: limits.clients: -1 is out of range; use 1 to 2048"},
      {"[heap]\nwindows_per_process = 9\n",
       "f.toml:2:23: heap.windows_per_process: 9 is out of range; use 1 to 8"},
      {"[heap]\nwindow_bytes = \"1MiB\"\n",
       "f.toml:2:16: heap.window_bytes: \"1MiB\" is out of range; use 64MiB to 16TiB, or \"auto\""},
      {"[heap]\nwindow_bytes = 0\n",
       "f.toml:2:16: heap.window_bytes: 0 is out of range; use 64MiB to 16TiB, or \"auto\""},
      {"[heap]\nwindow_bytes = 67108865\n",
       "f.toml:2:16: heap.window_bytes: 67108865 is not a multiple of 2MiB; the next ones are "
       "64MiB and 66MiB"},
      {"[heap]\narena_base = 0x300000001000\n",
       "f.toml:2:14: heap.arena_base: 52776558137344 is not a multiple of 2MiB; the next ones are "
       "48TiB and 50331650MiB"},
      {"[heap]\narena_bytes = \"1048577MiB\"\n",
       "f.toml:2:15: heap.arena_bytes: \"1048577MiB\" is not a multiple of 2MiB; the next ones are "
       "1TiB and 1048578MiB"},
      {"[heap]\nwindow_bytes = \"16GB\"\n",
       "f.toml:2:16: heap.window_bytes: \"16GB\" is not a size; write an integer of bytes, or a "
       "size "
       "like \"16GiB\" (B, KiB, MiB, GiB, TiB), or \"auto\""},
      {"[quota]\nheap_bytes = \"1KiB\"\n",
       "f.toml:2:14: quota.heap_bytes: \"1KiB\" is out of range; use 64MiB to 32768TiB, or "
       "\"auto\", or \"unlimited\""},
      {"[daemon]\nlog_level = \"loud\"\n",
       "f.toml:2:13: daemon.log_level: \"loud\" is not a log level; use error, warning, notice, "
       "info, "
       "debug"},
      {"[daemon]\nsocket_mode = 660\n",
       "f.toml:2:15: daemon.socket_mode: 660 is not a socket mode; write it octal, with the "
       "owner's rights in it: \"0660\" or 0o660"},
      {"[daemon]\nsocket_mode = \"0060\"\n",
       "f.toml:2:15: daemon.socket_mode: \"0060\" is not a socket mode; write it octal, with the "
       "owner's rights in it: \"0660\" or 0o660"},
      {"[daemon]\nsocket_group = \"nobodies\"\n",
       "f.toml:2:16: daemon.socket_group: there is no group \"nobodies\"; create it (groupadd "
       "--system), or use another one"},
      {"[daemon]\nsocket = \"run/x\"\n",
       "f.toml:2:10: daemon.socket: \"run/x\" is not the absolute path of a file; start with a "
       "slash, end without one, and use no control characters"},
      {"[daemon]\nsocket = \"/run/\\u0001\"\n",
       "f.toml:2:10: daemon.socket: \"/run/\\x01\" is not the absolute path of a file; start with "
       "a "
       "slash, end without one, and use no control characters"},
      {"[daemon]\nsocket = \"" + long_path + "\"\n",
       "f.toml:2:10: daemon.socket: a path of 108 bytes is too long; use at most 107 (the kernel's "
       "bound for sockets)"},
      // contradictions
      {"[limits]\nslots_per_publisher = 1000\n",
       "f.toml:2:23: limits.slots_per_publisher: slots_per_publisher (1000) leaves no room beside "
       "a "
       "history of depth_max (1000); make slots_per_publisher larger than depth_max"},
      {"[limits]\nslots_per_publisher = 1500\n",
       "f.toml:2:23: limits.slots_per_publisher: slots_per_publisher (1500) leaves no room for a "
       "message "
       "of each of subscriptions_per_topic (2048) beside a history of depth_max (1000); make it at "
       "least 3083, or one of the others less"},
      {"[heap]\nwindow_bytes = \"1GiB\"\narena_bytes = \"512MiB\"\n",
       "f.toml:3:15: heap.arena_bytes: arena_bytes (512MiB) is less than one window_bytes (1GiB); "
       "use one window for each process at least"},
      {"[heap]\nwindow_bytes = \"1GiB\"\n[quota]\nheap_bytes = \"512MiB\"\n",
       "f.toml:4:14: quota.heap_bytes: heap_bytes (512MiB) is less than one window (1GiB); no "
       "process "
       "could publish; use a multiple of heap.window_bytes"},
      // access rules
      {"[access]\ntopic = \"/a\"\n",
       "f.toml:1:1: access: a table is not allowed here; write each rule as a table: [[access]]"},
      {"access = [1]\n",
       "f.toml:1:11: access: an integer is not allowed here; write each rule as a table: "
       "[[access]]"},
      {"[[access]]\npublish = []\n",
       "f.toml:1:1: access.topic: is missing; name the topics: topic = \"/lidar/**\""},
      {"[[access]]\ntopic = \"/a\"\n",
       "f.toml:1:1: access: the rule has no effect; add publish or subscribe with a list"},
      {"[[access]]\ntopic = \"a\"\npublish = []\n",
       "f.toml:2:9: access.topic: \"a\": a pattern starts with a slash or with **, at character 1; "
       "write a pattern of topic names: \"/lidar/**\""},
      {"[[access]]\ntopic = \"/a\"\npublihs = []\nsubscribe = []\n",
       "f.toml:3:1: access.publihs: unknown key; did you mean \"publish\"?"},
      {"[[access]]\ntopic = \"/a\"\ndomain = -1\npublish = []\n",
       "f.toml:3:10: access.domain: -1 is out of range; use 0 to 4294967295"},
      {"[[access]]\ntopic = \"/a\"\ndomain = \"x\"\npublish = []\n",
       "f.toml:3:10: access.domain: a string is not allowed here; write an integer, a "
       "ROS_DOMAIN_ID"},
      {"[[access]]\ntopic = \"/a\"\npublish = \"*\"\n",
       "f.toml:3:11: access.publish: a string is not allowed here; write a list: [\"user:NAME\", "
       "\"group:NAME\", \"uid:1000\", \"gid:1000\" or \"*\"]"},
      {"[[access]]\ntopic = \"/a\"\npublish = [1000]\n",
       "f.toml:3:12: access.publish: an integer is not allowed here; write strings: \"user:NAME\", "
       "\"group:NAME\", \"uid:1000\", \"gid:1000\" or \"*\""},
      {"[[access]]\ntopic = \"/a\"\npublish = [\"alice\"]\n",
       "f.toml:3:12: access.publish: \"alice\" names no user or group; write \"user:NAME\", "
       "\"group:NAME\", "
       "\"uid:1000\", \"gid:1000\" or \"*\""},
      {"[[access]]\ntopic = \"/a\"\npublish = [\"user:bob\"]\n",
       "f.toml:3:12: access.publish: there is no user \"bob\"; correct the name, or use "
       "uid:NUMBER"},
      {"[[access]]\ntopic = \"/a\"\nsubscribe = [\"group:bob\"]\n",
       "f.toml:3:14: access.subscribe: there is no group \"bob\"; correct the name, or use "
       "gid:NUMBER"},
      {"[[access]]\ntopic = \"/a\"\npublish = [\"uid:4294967295\"]\n",
       "f.toml:3:12: access.publish: \"uid:4294967295\" is not the id of a user; use 0 to "
       "4294967294"},
      {"[[access]]\ntopic = \"/a\"\npublish = [\"gid:x\"]\n",
       "f.toml:3:12: access.publish: \"gid:x\" is not the id of a group; use 0 to 4294967294"},
      {"[[access]]\ntopic = \"/a\"\npublish = []\n[[access]]\ntopic = \"/a\"\ndomain = 3\npublish "
       "= "
       "[\"*\"]\n",
       "f.toml:4:1: access.publish: never decides: line 1 has the same topics and comes first; "
       "join "
       "both rules, or put the narrower one first"},
      {"[limits]\nwide_topics = [\"/a\", \"b\"]\n",
       "f.toml:2:22: limits.wide_topics: \"b\": a fully qualified name starts with a slash, at "
       "character 1; "
       "write it as "
       "`agnocast-ctl topic list` shows it: \"/rosout\""},
      {"[limits]\nwide_topics = [\"/a\", \"/a\"]\n",
       "f.toml:2:22: limits.wide_topics: \"/a\" is there twice; remove one"},
      {"[limits]\nwide_topics = \"/a\"\n",
       "f.toml:2:15: limits.wide_topics: a string is not allowed here; write a list of topics"},
  };
  for (const auto& row : rows) EXPECT_EQ(errors_of(row.text), row.errors);
}

TEST(Config, AllMistakesAreReportedInTheOrderOfTheFile) {
  EXPECT_EQ(
      errors_of("[quota]\nclients = -1\n[limits]\ntopics = 0\ndepht_max = 1\n"),
      "f.toml:2:11: quota.clients: -1 is out of range; use 1 to 4294967296, or \"unlimited\"\n"
      "f.toml:4:10: limits.topics: 0 is out of range; use 1 to 4096\n"
      "f.toml:5:1: limits.depht_max: unknown key; did you mean \"depth_max\"?");
}

TEST(Config, NarrowerRuleMayComeBeforeAWiderOne) {
  const char* const text =
      "[[access]]\ntopic = \"/a\"\ndomain = 3\npublish = [\"*\"]\n"
      "[[access]]\ntopic = \"/a\"\npublish = []\n"
      "[[access]]\ntopic = \"/a\"\nsubscribe = []\n";
  ASSERT_TRUE(parse(text)) << errors_of(text);
  EXPECT_EQ(parse(text)->access.size(), 3U);
}

// The words come from toml++; position, file and remedy are ours.
TEST(Config, SyntaxErrorsAndDuplicatesHaveTheirPosition) {
  EXPECT_THAT(errors_of("[limits]\ntopics = = 5\n"),
              StartsWith("f.toml:2:10: Error while parsing"));
  EXPECT_THAT(errors_of("[limits]\ntopics = 5\ntopics = 6\n"), StartsWith("f.toml:3:"));
  EXPECT_THAT(errors_of("[limits]\ntopics = 5\ntopics = 6\n"), testing::HasSubstr("redefine"));
  EXPECT_THAT(errors_of("[limits]\n[limits]\n"), StartsWith("f.toml:2:"));
  EXPECT_THAT(errors_of("[limits\n"), EndsWith("; correct the TOML there"));
  EXPECT_THAT(errors_of("a = \"\xff\"\n"), StartsWith("f.toml:1:"));
  EXPECT_EQ(errors_of("# \xc3\xbc\n[limits]\n  \xc3\xbc = 5\n"),
            "f.toml:3:3: a character that is not ASCII; write it in a comment, or as \\uXXXX");
  EXPECT_THAT(errors_of("[daemon]\nsocket = \"/\xc3\xbc\"\n"), StartsWith("f.toml:2:12:"));
}

TEST(Config, UnreadableFilesSayWhy) {
  test::TemporaryDirectory directory;
  const auto error_of = [](const std::string& file) {
    const auto config = load_config(file, names);
    return config ? "no error" : config.error().front().text();
  };
  const std::string missing = directory.path("missing.toml");
  EXPECT_EQ(error_of(missing), missing +
                                   ": cannot be read: No such file or directory; name another "
                                   "file with --config");
  EXPECT_EQ(error_of(directory.path()),
            directory.path() + ": cannot be read: Is a directory; name another file with --config");
  EXPECT_EQ(error_of("/dev/zero"),
            "/dev/zero: cannot be read: File too large; name another file with --config");

  if (::geteuid() != 0) GTEST_SKIP() << "the rest needs root to become another user";
  const std::string secret = directory.path("secret.toml");
  std::ofstream(secret) << "\n";
  ASSERT_EQ(::chmod(directory.path().c_str(), 0711), 0);
  ASSERT_EQ(::chmod(secret.c_str(), 0600), 0);
  test::Child child([&] {
    if (::setuid(65534) != 0) return 1;
    return error_of(secret) == secret +
                                   ": cannot be read: Permission denied; let the user of "
                                   "agnocastd read it"
               ? 0
               : 2;
  });
  EXPECT_EQ(child.wait(), 0);
}

TEST(Config, PrintedConfigurationsReadBackTheSame) {
  std::mt19937_64 random(20260131);
  const auto below = [&](std::uint64_t bound) { return random() % bound; };
  for (int round = 0; round < 300; ++round) {
    Config config;
    if (below(2)) config.daemon.socket = "/run/a b\"\\" + std::to_string(below(1000)) + ".sock";
    if (below(2)) config.daemon.runtime_directory = "/run/x";
    config.daemon.socket_mode = static_cast<std::uint32_t>(0600 + below(0200));
    if (below(2)) config.daemon.socket_group = "sensors";
    config.daemon.log_level = static_cast<LogLevel>(3 + below(5));
    if (below(2)) config.heap.window_bytes = (32 + below(1 << 12)) * abi::window_granule_bytes;
    if (below(2))
      config.heap.arena_base =
          (std::uint64_t{1} << 32) + below(1 << 20) * abi::window_granule_bytes;
    if (below(2))
      config.heap.arena_bytes =
          (std::uint64_t{1} << 40) + below(1 << 20) * abi::window_granule_bytes;
    config.limits.depth_max = static_cast<std::uint32_t>(1 + below(500));
    config.limits.slots_per_publisher = static_cast<std::uint32_t>(541 + below(1000));
    config.limits.subscriptions_per_topic = static_cast<std::uint32_t>(
        1 + below(std::min<std::uint64_t>(
                abi::subscription_count_max,
                config.limits.slots_per_publisher - config.limits.depth_max - 35)));
    if (below(2)) config.limits.wide_topics.resize(below(3));
    config.quota.publishers = below(1 << 20);
    if (below(2)) config.quota.publishers_per_topic = 1 + below(300);
    if (below(3) == 0) config.quota.subscriptions_per_topic = unlimited;
    if (below(2)) config.quota.clients = unlimited;
    if (below(2)) config.quota.heap_bytes = (std::uint64_t{1} << 40) + below(1 << 20);
    if (below(3) == 0) config.quota.heap_bytes = unlimited;
    for (std::uint64_t i = below(3); i > 0; --i) {
      AccessRule rule;
      rule.topic = "/topic" + std::to_string(i) + "/**";
      if (below(2)) rule.domain = below(233);
      if (below(2)) rule.publish = Principals{false, {1000, 7}, {}, {"user:alice", "uid:7"}};
      if (!rule.publish || below(2))
        rule.subscribe = Principals{true, {}, {50}, {"*", "group:sensors"}};
      config.access.push_back(rule);
    }
    const std::string text = to_toml(config);
    const auto again = parse(text);
    ASSERT_TRUE(again) << again.error().front().text() << '\n' << text;
    ASSERT_EQ(*again, config) << text;
  }
}

TEST(Config, SizesAreExact) {
  EXPECT_EQ(parse_bytes("1B"), 1U);
  EXPECT_EQ(parse_bytes("16GiB"), std::uint64_t{16} << 30);
  EXPECT_EQ(parse_bytes("3 KiB"), 3072U);
  EXPECT_EQ(parse_bytes("16777215TiB"), std::uint64_t{16777215} << 40);
  for (const char* text : {"", "GiB", "16", "16gib", "16GB", "1.5GiB", "-1GiB", " 1GiB", "1GiB ",
                           "1  GiB", "16777216TiB", "99999999999999999999B", "0x10B"})
    EXPECT_EQ(parse_bytes(text), std::nullopt) << text;
  EXPECT_EQ(bytes_text(0), "0B");
  EXPECT_EQ(bytes_text(4097), "4097B");
  EXPECT_EQ(bytes_text(1536 << 20), "1536MiB");
  EXPECT_EQ(bytes_text(std::uint64_t{16} << 30), "16GiB");
}

TEST(Config, SystemKnowsRoot) {
  const NameLookup system = NameLookup::system();
  EXPECT_EQ(system.user("root"), uid_t{0});
  EXPECT_EQ(system.group("root"), gid_t{0});
  EXPECT_EQ(system.user("no such user at all"), std::nullopt);
  EXPECT_EQ(system.group("no such group at all"), std::nullopt);
}

}  // namespace
}  // namespace agnocast::daemon
