// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/unicode.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/unit/bridge/golden_sample.hpp>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <stdexcept>

namespace agnocast::test {
namespace {

using nlohmann::json;

template <class Number>
Number number_of(const json& value) {
  if constexpr (std::is_floating_point_v<Number>) {
    if (value == "NaN") return std::numeric_limits<Number>::quiet_NaN();
    if (value == "Infinity") return std::numeric_limits<Number>::infinity();
    if (value == "-Infinity") return -std::numeric_limits<Number>::infinity();
    return static_cast<Number>(value.get<double>());
  } else {
    const auto number = value.get<Number>();
    if (json(number) != value) throw std::runtime_error("not of this type: " + value.dump());
    return number;
  }
}

void set_element(const MessageMember& member, const json& value, std::byte* at) {
  const auto store = [&]<class Number>(Number number) { std::memcpy(at, &number, sizeof number); };
  switch (member.type_id_) {
    case ros::ROS_TYPE_MESSAGE:
      return set_message(agnocast::detail::nested_members(member), value, at);
    case ros::ROS_TYPE_STRING:
      *reinterpret_cast<std::string*>(at) = value.get<std::string>();
      return;
    case ros::ROS_TYPE_WSTRING:
      *reinterpret_cast<std::u16string*>(at) =
          ctl::to_utf16(ctl::from_utf8(value.get<std::string>()).value());
      return;
    case ros::ROS_TYPE_BOOLEAN:
      return store(value.get<bool>());
    case ros::ROS_TYPE_INT8:
      return store(number_of<std::int8_t>(value));
    case ros::ROS_TYPE_INT16:
      return store(number_of<std::int16_t>(value));
    case ros::ROS_TYPE_UINT16:
      return store(number_of<std::uint16_t>(value));
    case ros::ROS_TYPE_INT32:
      return store(number_of<std::int32_t>(value));
    case ros::ROS_TYPE_UINT32:
      return store(number_of<std::uint32_t>(value));
    case ros::ROS_TYPE_INT64:
      return store(number_of<std::int64_t>(value));
    case ros::ROS_TYPE_UINT64:
      return store(number_of<std::uint64_t>(value));
    case ros::ROS_TYPE_FLOAT:
      return store(number_of<float>(value));
    case ros::ROS_TYPE_DOUBLE:
      return store(number_of<double>(value));
    default:
      return store(number_of<std::uint8_t>(value));
  }
}

}  // namespace

void set_message(const MessageMembers& members, const json& value, void* message) {
  if (value.size() != members.member_count_)
    throw std::runtime_error(std::string("not the members of ") + members.message_name_);
  for (std::uint32_t i = 0; i < members.member_count_; ++i) {
    const MessageMember& member = members.members_[i];
    const json& element = value.at(member.name_);
    auto* const at = static_cast<std::byte*>(message) + member.offset_;
    if (!member.is_array_) {
      set_element(member, element, at);
      continue;
    }
    if (is_fixed_array(member) && element.size() != member.array_size_)
      throw std::runtime_error(std::string("not the length of ") + member.name_);
    if (!is_fixed_array(member)) member.resize_function(at, element.size());
    for (std::size_t n = 0; n < element.size(); ++n) {
      if (is_bit_vector(member)) {
        const bool bit = element[n].get<bool>();
        member.assign_function(at, n, &bit);
      } else {
        set_element(member, element[n], element_at(member, static_cast<void*>(at), n));
      }
    }
  }
}

std::filesystem::path own_samples() {
  return std::filesystem::path(AGNOCAST_SOURCE_DIR) / "tests/golden";
}

std::filesystem::path recorded_samples() {
  const char* const folder = std::getenv("AGNOCAST_GOLDEN_CDR_DIR");
  return folder != nullptr && std::filesystem::is_directory(folder) ? folder : "";
}

std::vector<Sample> samples_with(const char* key) {
  std::vector<Sample> samples;
  for (const std::filesystem::path& folder : {own_samples(), recorded_samples()}) {
    if (folder.empty()) continue;
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      if (entry.path().extension() != ".json") continue;
      std::ifstream file(entry.path());
      json content = json::parse(file);
      if (content.contains(key))
        samples.push_back({entry.path().filename().string(), std::move(content)});
    }
  }
  std::sort(samples.begin(), samples.end(),
            [](const Sample& a, const Sample& b) { return a.file < b.file; });
  return samples;
}

Bytes bytes_of_hex(const std::string& hex) {
  Bytes bytes;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
    bytes.push_back(std::byte(std::stoi(hex.substr(i, 2), nullptr, 16)));
  return bytes;
}

std::string hex_of(std::span<const std::byte> bytes) {
  std::string hex;
  for (const std::byte byte : bytes) {
    constexpr char digits[] = "0123456789abcdef";
    hex += digits[std::to_integer<unsigned>(byte) >> 4];
    hex += digits[std::to_integer<unsigned>(byte) & 15];
  }
  return hex;
}

}  // namespace agnocast::test
