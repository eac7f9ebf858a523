// SPDX-License-Identifier: Apache-2.0
//
// Goal: bridge.toml means what docs/bridge.md says; each mistake is reported with its position and
// what to write instead; the installed example has every key. Method: texts.

#include <bridge/dds/limits.hpp>
#include <bridge/program/config.hpp>
#include <bridge/program/options.hpp>
#include <bridge/program/status_socket.hpp>
#include <tests/support/machine/temporary_directory.hpp>

#include <gmock/gmock.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>

namespace agnocast::bridge {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

std::string text_of(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

TEST(BridgeConfig, IsEmptyByDefaultAndThenBridgesEverything) {
  const auto config = parse_config("", "bridge.toml");
  ASSERT_TRUE(config);
  EXPECT_FALSE(config->domain);
  EXPECT_THAT(config->bridge.rules, IsEmpty());
  EXPECT_EQ(config->bridge.otherwise, Direction::both);
  EXPECT_TRUE(config->bridge.announce);
}

TEST(BridgeConfig, ReadsEveryKey) {
  const auto config = parse_config(R"(
domain = 7
discovery_info = "iron"
type_paths = ["/opt/robot/lib"]
log_level = "debug"
default = "none"
announce = false
[[topic]]
name = "/lidar/**"
direction = "out"
to_dds = { reliability = "best_effort", durability = "volatile", depth = 1 }
[[topic]]
name = "/map"
type = "nav_msgs/msg/OccupancyGrid"
direction = "in"
always = true
[topic.from_dds]
reliability = "reliable"
durability = "transient_local"
depth = 5
)",
                                   "bridge.toml");
  ASSERT_TRUE(config) << config.error()[0].where() << config.error()[0].what;
  EXPECT_EQ(config->domain, 7u);
  EXPECT_EQ(config->bridge.speak, RosGraph::Speak::iron);
  EXPECT_EQ(config->bridge.type_paths, std::vector<std::string>{"/opt/robot/lib"});
  EXPECT_EQ(config->log_level, agnocast::LogLevel::debug);
  EXPECT_EQ(config->bridge.otherwise, Direction::none);
  EXPECT_FALSE(config->bridge.announce);
  ASSERT_THAT(config->bridge.rules, SizeIs(2));
  const Rule& lidar = config->bridge.rules[0];
  EXPECT_EQ(lidar.topic, "/lidar/**");
  EXPECT_EQ(lidar.direction, Direction::outward);
  EXPECT_EQ(lidar.line, 8u);
  EXPECT_EQ(lidar.to_dds, (QosOverride{false, false, 1}));
  EXPECT_EQ(lidar.from_dds, QosOverride());
  EXPECT_FALSE(lidar.always);
  const Rule& map = config->bridge.rules[1];
  EXPECT_EQ(map.type, "nav_msgs/msg/OccupancyGrid");
  EXPECT_EQ(map.from_dds, (QosOverride{true, true, 5}));
  EXPECT_TRUE(map.always);
}

TEST(BridgeConfig, NamesAllMistakesInTheirOrderAndWhatToWrite) {
  const struct {
    const char* text;
    const char* where;
    const char* what;
    const char* remedy;
  } cases[] = {
      {"domain = 233", ":1:10: domain", "not a domain", "0 to 232"},
      {"default = \"some\"", ":1:11: default", "not a direction", "\"both\""},
      {"announce = 1", ":1:12: announce", "an integer is not allowed here", "true or false"},
      {"log_level = 3", ":1:13: log_level", "not a level", "\"info\""},
      {"discovery_info = \"jazzy\"", ":1:18: discovery_info", "not a layout", "\"iron\""},
      {"type_paths = [\"lib\"]", ":1:15: type_paths", "not an absolute path", "/opt/robot/lib"},
      {"topics = 1", ":1:1: topics", "unknown key", "did you mean \"topic\"?"},
      {"topic = 1", ":1:9: topic", "an integer is not allowed here", "[[topic]]"},
      {"colour = 1", ":1:1: colour", "unknown key",
       "known here: domain, discovery_info, type_paths, log_level, default, announce, topic"},
      {"[[topic]]\ndirection = \"in\"", ":1:1: topic", "no name", "name ="},
      {"[[topic]]\nname = \"a b\"", ":2:8: topic.name", "", "/lidar/**"},
      {"[[topic]]\nname = \"/a\"\ntype = \"String\"", ":3:8: topic.type", "not a ROS type",
       "std_msgs/msg/String"},
      {"[[topic]]\nname = \"/a\"\nalways = 1", ":3:10: topic.always",
       "an integer is not allowed here", "true or false"},
      {"[[topic]]\nname = \"/a/*\"\nalways = true\ndirection = \"out\"", ":1:1: topic.always",
       "pattern", "whole name"},
      {"[[topic]]\nname = \"/a\"\nalways = true", ":1:1: topic.always", "type",
       "direction = \"out\""},
      {"[[topic]]\nname = \"/a\"\nto_dds = 1", ":3:10: topic.to_dds",
       "an integer is not allowed here", "depth = 1"},
      {"[[topic]]\nname = \"/a\"\nto_dds = { depth = 0 }", ":3:20: topic.to_dds.depth",
       "not a depth", "1 to 100000"},
      {"[[topic]]\nname = \"/a\"\nfrom_dds = { durability = \"persistent\" }",
       ":3:27: topic.from_dds.durability", "not a known value",
       "\"transient_local\" or \"volatile\""},
      {"[[topic]]\nname = \"/a\"\nfrom_dds = { history = 1 }", ":3:14: topic.from_dds.history",
       "unknown key", "reliability, durability, depth"},
      {"domain = ", ":1:", "", "TOML"},
  };
  for (const auto& each : cases) {
    const auto config = parse_config(each.text, "bridge.toml");
    ASSERT_FALSE(config) << each.text;
    ASSERT_THAT(config.error(), SizeIs(1)) << each.text;
    EXPECT_THAT(config.error()[0].where(), HasSubstr(std::string("bridge.toml") + each.where));
    EXPECT_THAT(config.error()[0].what, HasSubstr(each.what)) << each.text;
    EXPECT_THAT(config.error()[0].remedy, HasSubstr(each.remedy)) << each.text;
  }
  const auto several = parse_config("x = 1\ndomain = -1\na = 2\n", "bridge.toml");
  ASSERT_FALSE(several);
  ASSERT_THAT(several.error(), SizeIs(3));
  EXPECT_THAT(several.error()[0].where(), HasSubstr(":1:1: x"));
  EXPECT_THAT(several.error()[1].where(), HasSubstr(":2:10: domain"));
  EXPECT_THAT(several.error()[2].where(), HasSubstr(":3:1: a"));
}

TEST(BridgeConfig, TheExampleAndTheDocumentHaveEveryKey) {
  const std::string example = AGNOCAST_SOURCE_DIR "/systemd/bridge.toml";
  const auto config = load_config(example);
  ASSERT_TRUE(config) << config.error()[0].where() << config.error()[0].what;
  const std::string document = text_of(AGNOCAST_SOURCE_DIR "/docs/bridge.md");
  for (const ConfigKey& key : config_keys()) {
    const std::string name(key.name.substr(key.name.rfind('.') + 1));
    EXPECT_THAT(text_of(example), HasSubstr(name + " = ")) << key.name;
    EXPECT_THAT(document, HasSubstr("| `" + name + '`')) << key.name;
  }
  EXPECT_FALSE(load_config("/nowhere/bridge.toml"));
}

TEST(BridgeConfig, UnreadableFilesSayWhy) {
  const test::TemporaryDirectory directory;
  const auto problem_of = [](const std::string& path) {
    const auto config = load_config(path);
    return config ? "none" : config.error().front().text();
  };
  const std::string folder = directory.path(), missing = directory.path("missing.toml");
  EXPECT_EQ(problem_of(missing),
            missing + ": it cannot be read: No such file or directory; ls -l " + missing);
  EXPECT_EQ(problem_of(folder), folder + ": it cannot be read: Is a directory; ls -l " + folder);
  const std::string endless = directory.path("endless.toml");
  std::ofstream(endless) << std::string((std::size_t{1} << 20) + 1, '#');
  EXPECT_EQ(problem_of(endless), endless + ": it cannot be read: File too large; ls -l " + endless);
}

TEST(BridgeConfig, TheFileOfTheDomainWinsOverTheGeneralOne) {
  const test::TemporaryDirectory directory;
  const std::string folder = directory.path();
  Options options;
  EXPECT_EQ(choose_config_file(options, folder), std::nullopt);
  std::ofstream(folder + "/bridge.toml");
  std::ofstream(folder + "/bridge-7.toml");
  EXPECT_EQ(choose_config_file(options, folder), folder + "/bridge.toml");
  options.domain = 7;
  EXPECT_EQ(choose_config_file(options, folder), folder + "/bridge-7.toml");
  options.domain = 8;
  EXPECT_EQ(choose_config_file(options, folder), folder + "/bridge.toml");
  options.config = "mine.toml";
  EXPECT_EQ(choose_config_file(options, folder), "mine.toml");
}

TEST(BridgeLimits, AreAllInTheDocument) {
  const std::string document = text_of(AGNOCAST_SOURCE_DIR "/docs/bridge.md");
  for (const LimitRow& row : limit_table) {
    const std::string most = row.most >= mebibyte ? std::to_string(row.most / mebibyte) + " MiB"
                             : row.most >= 1000
                                 ? std::to_string(row.most / 1000) + "," +
                                       std::to_string(1000 + row.most % 1000).substr(1)
                                 : std::to_string(row.most);
    EXPECT_THAT(document, HasSubstr("| `" + std::string(row.name) + "` | " + most + " |"));
    EXPECT_EQ(most_of(row.limit), row.most);
  }
}

TEST(BridgeConfig, TheStatusSocketIsWhereConfiguredElseBesideTheDaemonsSocket) {
  ::unsetenv("RUNTIME_DIRECTORY");
  ::setenv("AGNOCAST_SOCKET", "/tmp/x/agnocastd.sock", 1);
  EXPECT_EQ(choose_status_path("", 7), "/tmp/x/bridge-7.sock");
  ::setenv("RUNTIME_DIRECTORY", "/run/agnocast-bridge:/run/other", 1);
  EXPECT_EQ(choose_status_path("", 7), "/run/agnocast-bridge/bridge-7.sock");
  EXPECT_EQ(choose_status_path("/a.sock", 7), "/a.sock");
  ::unsetenv("RUNTIME_DIRECTORY");
}

TEST(BridgeOptions, SayWhatIsWrongAndHowToGetHelp) {
  const auto parse = [](std::vector<const char*> words) {
    words.insert(words.begin(), "agnocast-bridge");
    return parse_options(static_cast<int>(words.size()), words.data());
  };
  const auto help = std::get<Exit>(parse({"--help"}));
  EXPECT_EQ(help.status, 0);
  for (const auto& texts : {option_texts(), environment_texts(), exit_texts()}) {
    for (const HelpText& each : texts) EXPECT_THAT(help.out, HasSubstr(each.name));
  }
  for (const auto& wrong : {std::vector<const char*>{"--domain", "233"},
                            {"--log-level", "loud"},
                            {"--config", ""},
                            {"--unknown"},
                            {"extra"}}) {
    const auto exit = std::get<Exit>(parse(wrong));
    EXPECT_EQ(exit.status, 2) << wrong[0];
    EXPECT_THAT(exit.err, HasSubstr("\nhint: agnocast-bridge")) << wrong[0];
  }
  const auto options = std::get<Options>(parse({"--domain", "7", "--log-level", "debug"}));
  EXPECT_EQ(options.domain, 7u);
  EXPECT_EQ(options.log_level, agnocast::LogLevel::debug);
}

}  // namespace
}  // namespace agnocast::bridge
