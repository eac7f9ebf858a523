// SPDX-License-Identifier: Apache-2.0
//
// Content of the demo's messages: a PointCloud2 built by random operations of std::vector and
// std::string, in random order, and sealed with a checksum over every member.
//
// The seal is the last 16 characters of header.frame_id; it covers everything else, including the
// text before it. Each receiver computes it again. The same sum is computed over the sample of
// Cyclone DDS, so that both transports carry the same content and get the same check.
#pragma once

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace demo {

using Cloud = sensor_msgs::msg::PointCloud2;

/// Random numbers that follow from a seed (splitmix64).
class Random {
 public:
  explicit Random(std::uint64_t seed) noexcept : state_(seed) {}
  std::uint64_t next() noexcept {
    std::uint64_t word = state_ += 0x9e3779b97f4a7c15;
    word = (word ^ word >> 30) * 0xbf58476d1ce4e5b9;
    word = (word ^ word >> 27) * 0x94d049bb133111eb;
    return word ^ word >> 31;
  }
  /// 0 … bound - 1
  std::size_t below(std::size_t bound) noexcept { return static_cast<std::size_t>(next() % bound); }
  std::uint8_t byte() noexcept { return static_cast<std::uint8_t>(next()); }
  void fill(std::uint8_t* bytes, std::size_t count) noexcept {
    for (std::size_t done = 0; done < count; done += sizeof(std::uint64_t)) {
      const std::uint64_t word = next();
      std::memcpy(bytes + done, &word, std::min(count - done, sizeof word));
    }
  }

 private:
  std::uint64_t state_;
};

/// Any single changed byte changes the sum: each step is a bijection of the state.
class Checksum {
 public:
  void number(std::uint64_t value) noexcept {
    state_ = (state_ ^ value) * 0x9fb21c651e98df25;
    state_ ^= state_ >> 32;
  }
  void bytes(const void* begin, std::size_t count) noexcept {
    number(count);
    const auto* const from = static_cast<const unsigned char*>(begin);
    for (std::size_t done = 0; done < count; done += sizeof(std::uint64_t)) {
      std::uint64_t word = 0;
      std::memcpy(&word, from + done, std::min(count - done, sizeof word));
      number(word);
    }
  }
  void text(std::string_view text) noexcept { bytes(text.data(), text.size()); }
  std::uint64_t value() const noexcept { return state_; }

 private:
  std::uint64_t state_ = 0x5eed;
};

inline constexpr std::size_t seal_characters = 16;

/// The number of a message; every message of a run has its own.
inline std::uint64_t number_of(const Cloud& cloud) noexcept {
  return static_cast<std::uint32_t>(cloud.header.stamp.sec);
}

/// `frame_id` without its seal.
inline std::string_view unsealed(std::string_view frame_id) noexcept {
  return frame_id.substr(0, frame_id.size() - std::min(frame_id.size(), seal_characters));
}

inline std::string seal_text(std::uint64_t sum) {
  char text[seal_characters + 1];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(sum));
  return text;
}

/// Works for any type with PointCloud2's members whose text and sequences `Access` can read.
template <class Access, class Message>
std::uint64_t checksum_of(const Message& cloud, std::string_view frame_id_unsealed) noexcept {
  Checksum sum;
  sum.number(static_cast<std::uint32_t>(cloud.header.stamp.sec));
  sum.number(cloud.header.stamp.nanosec);
  sum.text(frame_id_unsealed);
  sum.number(cloud.height);
  sum.number(cloud.width);
  sum.number(Access::size(cloud.fields));
  for (std::size_t i = 0; i < Access::size(cloud.fields); ++i) {
    const auto& field = Access::begin(cloud.fields)[i];
    sum.text(Access::text(field.name));
    sum.number(field.offset);
    sum.number(field.datatype);
    sum.number(field.count);
  }
  sum.number(cloud.is_bigendian);
  sum.number(cloud.point_step);
  sum.number(cloud.row_step);
  sum.bytes(Access::begin(cloud.data), Access::size(cloud.data));
  sum.number(cloud.is_dense);
  return sum.value();
}

struct RosAccess {
  template <class T>
  static std::size_t size(const std::vector<T>& items) noexcept {
    return items.size();
  }
  template <class T>
  static const T* begin(const std::vector<T>& items) noexcept {
    return items.data();
  }
  static std::string_view text(const std::string& text) noexcept { return text; }
};

inline void seal(Cloud& cloud) {
  cloud.header.frame_id += seal_text(checksum_of<RosAccess>(cloud, cloud.header.frame_id));
}

template <class Access, class Message>
bool is_intact(const Message& cloud) {
  const std::string_view frame = Access::text(cloud.header.frame_id);
  const std::string_view plain = unsealed(frame);
  return frame.substr(plain.size()) == seal_text(checksum_of<Access>(cloud, plain));
}

/// Builds `bytes` bytes by operations that `random` picks. Grows on the whole.
inline void build_data(std::vector<std::uint8_t>& data, std::size_t bytes, Random& random) {
  while (data.size() < bytes) {
    const std::size_t old = data.size();
    const std::size_t room = bytes - old;
    const std::size_t some = 1 + random.below(std::min(room, std::max<std::size_t>(bytes / 6, 64)));
    switch (random.below(8)) {
      case 0:
        for (std::size_t i = 0; i < std::min<std::size_t>(some, 20000); ++i)
          data.push_back(random.byte());
        break;
      case 1:
        data.resize(old + some);
        random.fill(data.data() + old, some);
        break;
      case 2: {
        std::vector<std::uint8_t> block(some);
        random.fill(block.data(), some);
        data.insert(data.begin() + static_cast<std::ptrdiff_t>(random.below(old + 1)),
                    block.begin(), block.end());
        break;
      }
      case 3:
        // Discards the content, so only near the beginning.
        if (old < bytes / 4) data.assign(some, random.byte());
        break;
      case 4:
        data.reserve(old + some);
        break;
      case 5:
        data.shrink_to_fit();
        break;
      case 6: {
        const std::size_t gone = random.below(std::min<std::size_t>(old, 100) + 1);
        data.erase(data.begin(), data.begin() + static_cast<std::ptrdiff_t>(gone));
        break;
      }
      default: {
        std::vector<std::uint8_t> copy(data);
        copy.push_back(random.byte());
        data = std::move(copy);
        break;
      }
    }
  }
}

inline void build_fields(decltype(Cloud::fields)& fields, Random& random) {
  fields.resize(random.below(3));
  const std::size_t count = 3 + random.below(6);
  while (fields.size() < count) {
    if (random.below(2) == 0) {
      fields.emplace_back();
    } else {
      fields.insert(fields.begin(), sensor_msgs::msg::PointField());
    }
  }
  for (std::size_t i = 0; i < count; ++i) {
    // Short names are inside the string object, long ones in allocated memory.
    fields[i].name.assign(1 + random.below(40), static_cast<char>('a' + i));
    fields[i].offset = static_cast<std::uint32_t>(i * 4);
    fields[i].datatype = sensor_msgs::msg::PointField::FLOAT32;
    fields[i].count = 1 + static_cast<std::uint32_t>(random.below(3));
  }
}

/// Everything but `data`.
inline void build_frame(Cloud& cloud, std::uint64_t number, std::size_t bytes, Random& random) {
  cloud.header.stamp.sec = static_cast<std::int32_t>(number);
  cloud.header.stamp.nanosec = static_cast<std::uint32_t>(random.below(1000000000));
  cloud.header.frame_id = "lidar_top";
  for (std::size_t words = random.below(5); words > 0; --words)
    cloud.header.frame_id.append(" of cloud ").append(std::to_string(number)).push_back(',');
  build_fields(cloud.fields, random);
  cloud.height = 1 + static_cast<std::uint32_t>(random.below(64));
  cloud.width = static_cast<std::uint32_t>(random.next());
  cloud.point_step = 16;
  cloud.row_step = static_cast<std::uint32_t>(bytes / cloud.height);
  cloud.is_bigendian = random.below(2) == 1;
  cloud.is_dense = random.below(2) == 1;
}

/// Builds a whole sealed message with `bytes` of data. Its content follows from its number.
inline void build(Cloud& cloud, std::uint64_t number, std::size_t bytes) {
  Random random(number);
  build_frame(cloud, number, bytes, random);
  build_data(cloud.data, bytes, random);
  seal(cloud);
}

/// Returns the addresses of a message: the object, and the memory of its members. One line
/// without spaces.
inline std::string places_of(const Cloud& cloud) {
  char text[128];
  std::snprintf(text, sizeof text, "%p,%p,%p,%p", static_cast<const void*>(&cloud),
                static_cast<const void*>(cloud.data.data()),
                static_cast<const void*>(cloud.fields.data()),
                static_cast<const void*>(cloud.header.frame_id.data()));
  return text;
}

}  // namespace demo
