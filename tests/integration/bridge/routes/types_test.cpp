// SPDX-License-Identifier: Apache-2.0
//
// Goal: a message of any type leaves the bridge as it entered it, whatever its values. Method:
// every installed type, and types made at random, in the real bridge; both ways at once. The bytes
// in DDS are compared with, and come from, tests/golden/encode.py, which shares no code with the
// bridge.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/unit/bridge/golden_sample.hpp>

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>

#include <every_message_name.hpp>

#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <map>

namespace agnocast::test {
namespace {

using nlohmann::json;

std::string ros_name_of(const MessageMembers& members) {
  std::string name = std::string(members.message_namespace_) + "/" + members.message_name_;
  for (std::size_t at; (at = name.find("::")) != std::string::npos;) name.replace(at, 2, "/");
  return name;
}

/// Returns the type as .msg files write it.
std::string type_text_of(const MessageMember& member) {
  static const std::map<std::uint8_t, std::string> names = {
      {ros::ROS_TYPE_BOOLEAN, "bool"},   {ros::ROS_TYPE_OCTET, "byte"},
      {ros::ROS_TYPE_UINT8, "uint8"},    {ros::ROS_TYPE_CHAR, "char"},
      {ros::ROS_TYPE_INT8, "int8"},      {ros::ROS_TYPE_UINT16, "uint16"},
      {ros::ROS_TYPE_INT16, "int16"},    {ros::ROS_TYPE_UINT32, "uint32"},
      {ros::ROS_TYPE_INT32, "int32"},    {ros::ROS_TYPE_UINT64, "uint64"},
      {ros::ROS_TYPE_INT64, "int64"},    {ros::ROS_TYPE_FLOAT, "float32"},
      {ros::ROS_TYPE_DOUBLE, "float64"}, {ros::ROS_TYPE_STRING, "string"},
      {ros::ROS_TYPE_WSTRING, "wstring"}};
  std::string text = member.type_id_ == ros::ROS_TYPE_MESSAGE
                         ? ros_name_of(agnocast::detail::nested_members(member))
                         : names.at(member.type_id_);
  if (is_fixed_array(member)) return text + "[" + std::to_string(member.array_size_) + "]";
  return member.is_array_ ? text + "[]" : text;
}
void add_to_schema(const MessageMembers& members, json& schema) {
  json fields = json::array();
  for (std::uint32_t i = 0; i < members.member_count_; ++i) {
    const MessageMember& member = members.members_[i];
    fields.push_back({member.name_, type_text_of(member)});
    if (member.type_id_ == ros::ROS_TYPE_MESSAGE)
      add_to_schema(agnocast::detail::nested_members(member), schema);
  }
  schema[ros_name_of(members)] = fields;
}

template <class Number>
json number_at(const std::byte* at) {
  Number number;
  std::memcpy(&number, at, sizeof number);
  if constexpr (std::is_floating_point_v<Number>) {
    if (std::isnan(number)) return "NaN";
    if (std::isinf(number)) return number < 0 ? "-Infinity" : "Infinity";
  }
  return number;
}
json value_of(const MessageMembers& members, const void* message);
json element_value(const MessageMember& member, const std::byte* at) {
  switch (member.type_id_) {
    case ros::ROS_TYPE_MESSAGE:
      return value_of(agnocast::detail::nested_members(member), at);
    case ros::ROS_TYPE_STRING:
      return *reinterpret_cast<const std::string*>(at);
    case ros::ROS_TYPE_WSTRING: {
      const auto& wide = *reinterpret_cast<const std::u16string*>(at);
      return std::string(wide.begin(), wide.end());  // letters
    }
    case ros::ROS_TYPE_BOOLEAN:
      return number_at<bool>(at);
    case ros::ROS_TYPE_INT8:
      return number_at<std::int8_t>(at);
    case ros::ROS_TYPE_INT16:
      return number_at<std::int16_t>(at);
    case ros::ROS_TYPE_UINT16:
      return number_at<std::uint16_t>(at);
    case ros::ROS_TYPE_INT32:
      return number_at<std::int32_t>(at);
    case ros::ROS_TYPE_UINT32:
      return number_at<std::uint32_t>(at);
    case ros::ROS_TYPE_INT64:
      return number_at<std::int64_t>(at);
    case ros::ROS_TYPE_UINT64:
      return number_at<std::uint64_t>(at);
    case ros::ROS_TYPE_FLOAT:
      return number_at<float>(at);
    case ros::ROS_TYPE_DOUBLE:
      return number_at<double>(at);
    default:
      return number_at<std::uint8_t>(at);
  }
}
json value_of(const MessageMembers& members, const void* message) {
  json value = json::object();
  for (std::uint32_t i = 0; i < members.member_count_; ++i) {
    const MessageMember& member = members.members_[i];
    const std::byte* const at = static_cast<const std::byte*>(message) + member.offset_;
    if (!member.is_array_) {
      value[member.name_] = element_value(member, at);
      continue;
    }
    json list = json::array();
    for (std::size_t n = 0; n < element_count(member, at); ++n) {
      if (is_bit_vector(member)) {
        list.push_back(bool((*reinterpret_cast<const std::vector<bool>*>(at))[n]));
      } else {
        list.push_back(element_value(member, element_at(member, static_cast<const void*>(at), n)));
      }
    }
    value[member.name_] = list;
  }
  return value;
}

/// The test messages of a type, and the received ones.
struct Tried {
  std::string name;
  IntrospectedType type;
  CdrType cdr;
  std::vector<OwnedGenericMessage> messages;
  std::vector<Bytes> wire;  // of each message
  GenericPublisher::SharedPtr publisher;
  GenericSubscription::SharedPtr subscription;
  DdsReader* reader = nullptr;
  DdsWriter* writer = nullptr;
};

// For each type; the last one has any text, which the encoder's files cannot express.
constexpr std::size_t message_count = 4;

class Types : public BridgeTest {
 protected:
  static std::string seed() {
    const char* const text = std::getenv("AGNOCAST_TEST_SEED");
    return text == nullptr ? "1" : text;
  }

  static std::vector<Tried> try_types(const std::vector<std::string>& names,
                                      const std::vector<std::string>& paths = {}) {
    std::vector<Tried> list;
    std::uint64_t number = std::stoull(seed()) * 100'000;
    const TemporaryDirectory files;
    for (const std::string& name : names) {
      const IntrospectedType type = find_message_type(name, paths);
      list.push_back({name, type, CdrType::of(type.members()).value(), {}, {}, {}, {}});
      Tried& tried = list.back();
      tried.wire.resize(message_count);
      json schema = json::object();
      add_to_schema(type.members(), schema);
      for (std::size_t i = 0; i < message_count; ++i) {
        const bool is_last = i + 1 == message_count;
        tried.messages.push_back(type.make());
        RandomMessages(number++, {.has_nan = true, .has_any_text = is_last})
            .fill(type.members(), tried.messages[i].get());
        if (is_last) {
          tried.wire[i].resize(bridge::cdr_bytes(tried.cdr, tried.messages[i].get()));
          EXPECT_TRUE(bridge::write_cdr(tried.cdr, tried.messages[i].get(), tried.wire[i]));
          continue;
        }
        std::ofstream(file_of(files, list.size(), i))
            << json{{"name", name},
                    {"ros_type", ros_name_of(type.members())},
                    {"schema", schema},
                    {"value", value_of(type.members(), tried.messages[i].get())}};
      }
    }
    const std::string command = std::string(AGNOCAST_PYTHON) + " " + AGNOCAST_SOURCE_DIR +
                                "/tests/golden/encode.py --fill " + files.path();
    EXPECT_EQ(std::system(command.c_str()), 0);
    for (std::size_t t = 0; t < list.size(); ++t) {
      for (std::size_t i = 0; i + 1 < message_count; ++i) {
        std::ifstream file(file_of(files, t + 1, i));
        list[t].wire[i] = bytes_of_hex(json::parse(file).at("cdr_hex").get<std::string>());
      }
    }
    return list;
  }

  void expect_unchanged_both_ways(std::vector<Tried> list) {
    // A topic keeps its type for a while.
    const std::string base = topic() + std::to_string(++batch_count_);
    DdsQos qos;
    qos.depth = static_cast<std::int32_t>(message_count);
    for (std::size_t t = 0; t < list.size(); ++t) {
      Tried& tried = list[t];
      const std::string dds_type = bridge::dds_type_of(tried.name).value();
      const std::string out = base + "/out" + std::to_string(t),
                        in = base + "/in" + std::to_string(t);
      tried.reader = &other_.reads("rt" + out, dds_type, qos);
      tried.writer = &other_.writes("rt" + in, dds_type, qos);
      tried.publisher = create_generic_publisher(node_, out, tried.type, message_count);
      tried.subscription = create_generic_subscription(node_, in, tried.type, message_count);
    }
    for (const Tried& tried : list) {
      ASSERT_TRUE(other_.eventually([&] {
        return tried.reader->matched() == 1 && tried.writer->matched() == 1 &&
               tried.publisher->get_linked_subscription_count() == 1;
      })) << tried.name;
    }
    for (Tried& tried : list) {
      for (std::size_t i = 0; i < message_count; ++i) {
        auto loan = tried.publisher->borrow_loaned_message();
        tried.type.assign(tried.messages[i].get(), loan.get());
        ASSERT_TRUE(tried.publisher->publish(std::move(loan))) << tried.name;
        ASSERT_EQ(send(*tried.writer, tried.wire[i]).value(), bridge::WriteOutcome::sent);
      }
    }
    for (Tried& tried : list) {
      for (std::size_t i = 0; i < message_count; ++i) {
        SCOPED_TRACE(tried.name + ", message " + std::to_string(i) + ", AGNOCAST_TEST_SEED " +
                     seed());
        const auto sample = other_.take<Received>(*tried.reader);
        ASSERT_NE(sample, nullptr);
        Bytes wanted = tried.wire[i];
        wanted.resize((wanted.size() + 3) / 4 * 4);
        EXPECT_EQ(hex_of(sample->bytes), hex_of(wanted));
        const auto message = take_soon(tried.subscription);
        ASSERT_TRUE(message);
        std::string where;
        EXPECT_TRUE(are_same(tried.type.members(), message.get(), tried.messages[i].get(), &where))
            << where;
      }
      EXPECT_FALSE(tried.reader->take());
      EXPECT_FALSE(tried.subscription->take());
    }
    other_.forget();
  }

 private:
  static std::string file_of(const TemporaryDirectory& files, std::size_t type,
                             std::size_t message) {
    return files.path() + "/" + std::to_string(type) + "_" + std::to_string(message) + ".json";
  }

  Node node_{"types"};
  int batch_count_ = 0;
};

TEST_F(Types, EachInstalledTypeGoesBothWaysUnchanged) {
  const std::vector<std::string> names(std::begin(every_message_name),
                                       std::end(every_message_name));
  constexpr std::size_t at_once = 70;
  for (std::size_t begin = 0; begin < names.size(); begin += at_once) {
    const auto first = names.begin() + static_cast<std::ptrdiff_t>(begin);
    const auto last =
        names.begin() + static_cast<std::ptrdiff_t>(std::min(begin + at_once, names.size()));
    expect_unchanged_both_ways(try_types({first, last}));
    ASSERT_FALSE(HasFatalFailure());
  }
}

TEST_F(Types, RandomTypesGoBothWaysUnchanged) {
  ::setenv("AGNOCAST_TEST_SEED", seed().c_str(), 1);
  const std::string directory = std::filesystem::path(AGNOCAST_RANDOM_TYPES).parent_path().string();
  const TemporaryDirectory files;
  std::ofstream(files.path() + "/bridge.toml") << "type_paths = [\"" << directory << "\"]\n";
  start_bridge({"--config", files.path() + "/bridge.toml"});
  std::vector<std::string> names;
  for (int i = 0; i < 40; ++i) names.push_back("agnocast_random_msgs/msg/T" + std::to_string(i));
  expect_unchanged_both_ways(try_types(names, {directory}));
}

}  // namespace
}  // namespace agnocast::test
