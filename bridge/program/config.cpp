// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/config.hpp>

#include <agnocast/topic_pattern.hpp>
#include <bridge/dds/names.hpp>
#include <config/mistakes.hpp>
#include <config/toml_file.hpp>

#include <cstring>
#include <string_view>
#include <utility>

namespace agnocast::bridge {
namespace {

// DDS keeps this many samples for each reader; a larger depth is a mistake.
constexpr std::int64_t depth_max = 100'000;

constexpr ConfigKey keys[] = {
    {"domain", "0 to 232; default: ROS_DOMAIN_ID, else 0",
     "The domain of DDS and of the bridged nodes of this host"},
    {"discovery_info", R"("humble", "iron" or "detect")",
     "Layout of ros_discovery_info: until Humble, since Iron, or that of most other participants"},
    {"type_paths", R"(["/opt/robot/lib"])",
     "Directories with libraries of message packages, besides AMENT_PREFIX_PATH"},
    {"log_level", R"("error", "warning", "notice", "info" or "debug")", "The level of the log"},
    {"default", R"("both", "out", "in" or "none")",
     "The direction of topics and services that no rule matches"},
    {"announce", "true or false",
     "Announce a publisher of this host in DDS even without a reader there, so that ros2 topic "
     "list shows its topic"},
    {"topic.name", R"("/lidar/**")",
     "Topics and services to which the rule applies; the first rule that matches decides"},
    {"topic.type", R"("std_msgs/msg/String")", "Only topics or services of this type"},
    {"topic.direction", R"("both", "out", "in" or "none")",
     "out: from this host to DDS, in: from DDS to this host"},
    {"topic.always", "true or false",
     "Bridge even without an endpoint on the other side: messages of this host are written to DDS "
     "without a reader "
     "there, and messages from there are published here without a subscription"},
    {"topic.to_dds.reliability", R"("reliable" or "best_effort")",
     "Offered by DDS writers; default: as the publisher offers"},
    {"topic.to_dds.durability", R"("transient_local" or "volatile")", "As reliability"},
    {"topic.to_dds.depth", "1 to 100000", "Depth of their history, which is then keep-last"},
    {"topic.from_dds.reliability", R"("reliable" or "best_effort")",
     "Requested by DDS readers; default: as the writer offers"},
    {"topic.from_dds.durability", R"("transient_local" or "volatile")", "As reliability"},
    {"topic.from_dds.depth", "1 to 100000", "Depth of their history"},
};

/// Returns the names of the keys below `prefix`.
std::vector<std::string_view> known_below(std::string_view prefix) {
  std::vector<std::string_view> names;
  for (const ConfigKey& key : keys) {
    if (!key.name.starts_with(prefix)) continue;
    const std::string_view rest = key.name.substr(prefix.size());
    const std::string_view name = rest.substr(0, rest.find('.'));
    if (names.empty() || names.back() != name) names.push_back(name);
  }
  return names;
}

class Reader {
 public:
  explicit Reader(const std::string& file) : mistakes_(file) {}

  tl::expected<Config, std::vector<ConfigError>> read(const toml::table& root) {
    for (const auto& [key, node] : root) {
      const std::string_view name = key.str();
      if (name == "domain") {
        read_domain(node);
      } else if (name == "discovery_info") {
        read_layout(node);
      } else if (name == "type_paths") {
        read_paths(node);
      } else if (name == "log_level") {
        config_.log_level = log_level_of(node.value_or(std::string()));
        if (!config_.log_level)
          report(node.source(), name, "this is not a level",
                 R"(write "error", "warning", "notice", "info" or "debug")");
      } else if (name == "default") {
        read_direction(node, "default", config_.bridge.otherwise);
      } else if (name == "announce") {
        if (!node.is_boolean()) mistakes_.wrong_type(node, std::string(name), "true or false");
        config_.bridge.announce = node.value_or(true);
      } else if (name == "topic") {
        read_topics(node);
      } else {
        mistakes_.unknown(key, std::string(name), known_below(""));
      }
    }
    if (mistakes_.count() == 0) return std::move(config_);
    return tl::unexpected(mistakes_.take());
  }

 private:
  void report(const toml::source_region& place, std::string_view key, std::string what,
              std::string remedy) {
    mistakes_.report(place.begin, std::string(key), std::move(what), std::move(remedy));
  }

  void read_domain(const toml::node& node) {
    const auto* const number = node.as_integer();
    if (number == nullptr || number->get() < 0 || number->get() > domain_max)
      return report(node.source(), "domain", "this is not a domain",
                    "write a number from 0 to 232");
    config_.domain = static_cast<std::uint32_t>(number->get());
  }
  void read_layout(const toml::node& node) {
    const std::string text = node.value_or(std::string());
    if (text == "humble") {
      config_.bridge.speak = RosGraph::Speak::humble;
    } else if (text == "iron") {
      config_.bridge.speak = RosGraph::Speak::iron;
    } else if (text == "detect") {
      config_.bridge.speak = RosGraph::Speak::detect;
    } else {
      report(node.source(), "discovery_info", "this is not a layout",
             R"(write "humble", "iron" (and what came later) or "detect")");
    }
  }
  void read_paths(const toml::node& node) {
    const auto* const list = node.as_array();
    if (list == nullptr)
      return mistakes_.wrong_type(node, "type_paths", R"(directories: ["/opt/robot/lib"])");
    for (const toml::node& element : *list) {
      const std::string path = element.value_or(std::string());
      if (path.empty() || path[0] != '/') {
        report(element.source(), "type_paths", "this is not an absolute path",
               R"(write directories: ["/opt/robot/lib"])");
      } else {
        config_.bridge.type_paths.push_back(path);
      }
    }
  }
  void read_topics(const toml::node& node) {
    for (const toml::table* const table : mistakes_.tables(node, "topic")) read_topic(*table);
  }
  void read_direction(const toml::node& node, std::string_view key, Direction& direction) {
    const std::string text = node.value_or(std::string());
    if (text == "both") {
      direction = Direction::both;
    } else if (text == "out") {
      direction = Direction::outward;
    } else if (text == "in") {
      direction = Direction::inward;
    } else if (text == "none") {
      direction = Direction::none;
    } else {
      report(node.source(), key, "this is not a direction",
             R"(write "both", "out", "in" or "none")");
    }
  }
  /// Reads one of two words; the first means true.
  void read_choice(const toml::node& node, const std::string& key, const char* yes, const char* no,
                   std::optional<bool>& value) {
    const std::string text = node.value_or(std::string());
    if (text == yes || text == no) {
      value = text == yes;
    } else {
      report(node.source(), key, "this is not a known value",
             std::string("write \"") + yes + "\" or \"" + no + '"');
    }
  }
  void read_qos(const toml::node& node, const std::string& where, QosOverride& qos) {
    const auto* const table = node.as_table();
    if (table == nullptr)
      return mistakes_.wrong_type(node, where, R"({ reliability = "best_effort", depth = 1 })");
    for (const auto& [key, value] : *table) {
      const std::string name = where + '.' + std::string(key.str());
      if (key.str() == "reliability") {
        read_choice(value, name, "reliable", "best_effort", qos.reliable);
      } else if (key.str() == "durability") {
        read_choice(value, name, "transient_local", "volatile", qos.transient_local);
      } else if (key.str() == "depth") {
        const auto* const number = value.as_integer();
        if (number == nullptr || number->get() < 1 || number->get() > depth_max) {
          report(value.source(), name, "this is not a depth",
                 "write a number from 1 to " + std::to_string(depth_max));
        } else {
          qos.depth = static_cast<std::size_t>(number->get());
        }
      } else {
        mistakes_.unknown(key, name, known_below(where + '.'));
      }
    }
  }
  void read_topic(const toml::table& table) {
    Rule rule;
    rule.line = table.source().begin.line;
    bool has_name = false;
    for (const auto& [key, node] : table) {
      const std::string text = node.value_or(std::string());
      const std::string name = "topic." + std::string(key.str());
      if (name == "topic.name") {
        has_name = true;
        rule.topic = text;
        if (const auto problem = topic_pattern_problem(text))
          report(node.source(), name, *problem, R"(write a pattern of topic names: "/lidar/**")");
      } else if (name == "topic.type") {
        rule.type = text;
        if (!dds_type_of(text))
          report(node.source(), name, "this is not a ROS type",
                 R"(write it as "std_msgs/msg/String")");
      } else if (name == "topic.direction") {
        read_direction(node, name, rule.direction);
      } else if (name == "topic.always") {
        if (!node.is_boolean()) mistakes_.wrong_type(node, name, "true or false");
        rule.always = node.is_boolean() && node.value_or(false);
      } else if (name == "topic.to_dds") {
        read_qos(node, name, rule.to_dds);
      } else if (name == "topic.from_dds") {
        read_qos(node, name, rule.from_dds);
      } else {
        mistakes_.unknown(key, name, known_below("topic."));
      }
    }
    if (!has_name) report(table.source(), "topic", "it has no name", R"(write name = "/lidar/**")");
    if (rule.always) check_always(rule, table);
    config_.bridge.rules.push_back(std::move(rule));
  }
  void check_always(const Rule& rule, const toml::table& table) {
    if (!dds_topic_of({DdsTopicKind::topic, rule.topic}))
      report(table.source(), "topic.always", "it needs the name of one topic, not a pattern",
             R"(write the whole name: name = "/map")");
    if (goes(rule.direction, Direction::inward) && rule.type.empty())
      report(table.source(), "topic.always",
             "the type is unknown while the topic has no subscription",
             R"(write type = "nav_msgs/msg/OccupancyGrid", or direction = "out")");
  }

  Config config_;
  config::Mistakes mistakes_;
};

}  // namespace

std::span<const ConfigKey> config_keys() noexcept { return keys; }

tl::expected<Config, std::vector<ConfigError>> parse_config(const std::string& text,
                                                            const std::string& name) {
  auto table = config::parse_toml(text, name, "write it as TOML");
  if (table) return Reader(name).read(*table);
  return tl::unexpected(std::vector<ConfigError>{std::move(table.error())});
}

tl::expected<Config, std::vector<ConfigError>> load_config(const std::string& path) {
  const auto text = config::read_file(path);
  if (text) return parse_config(*text, path);
  return tl::unexpected(std::vector<ConfigError>{
      {path, 0, 0, "", std::string("it cannot be read: ") + std::strerror(text.error()),
       "ls -l " + path}});
}

}  // namespace agnocast::bridge
