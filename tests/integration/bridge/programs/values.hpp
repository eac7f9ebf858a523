// SPDX-License-Identifier: Apache-2.0
//
// Values and texts of messages whose type is ROS's C++ struct on one side and idlc's C struct on
// the other: members have the same names, so each type is described once. Values makes the same
// message of the same number on both sides; Text prints every member, blobs by length and hash.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <random>
#include <sstream>
#include <string>
#include <type_traits>
#include <vector>

namespace agnocast::test {

template <class T>
concept CSequence = requires(T sequence) {
  sequence._buffer;
  sequence._length;
};

template <class Sequence>
std::size_t count_of(const Sequence& sequence) {
  if constexpr (CSequence<Sequence>)
    return sequence._length;
  else
    return sequence.size();
}
template <class Sequence>
auto* elements_of(Sequence& sequence) {
  if constexpr (CSequence<Sequence>)
    return sequence._buffer;
  else
    return sequence.data();
}
/// Resizes an empty one.
template <class Sequence>
void resize(Sequence& sequence, std::size_t count) {
  if constexpr (CSequence<Sequence>) {
    // Allocates like Cyclone DDS, which frees it.
    using Element = std::remove_reference_t<decltype(*sequence._buffer)>;
    sequence._buffer = static_cast<Element*>(std::calloc(count, sizeof(Element)));
    sequence._length = sequence._maximum = static_cast<std::uint32_t>(count);
    sequence._release = true;
  } else {
    sequence.resize(count);
  }
}

/// Returns a scan of a real lidar if present, 20 bytes for each point; else as many other bytes.
inline const std::vector<std::uint8_t>& scan() {
  static const std::vector<std::uint8_t> bytes = [] {
    std::vector<std::uint8_t> data;
    if (const char* const folder = std::getenv("AGNOCAST_DATA_DIR")) {
      std::ifstream file(std::string(folder) + "/lidar_top_nuscenes.bin", std::ios::binary);
      data.assign(std::istreambuf_iterator<char>(file), {});
    }
    std::mt19937 random(1);
    if (data.empty())
      for (int i = 0; i < 700'000; ++i) data.push_back(static_cast<std::uint8_t>(random()));
    return data;
  }();
  return bytes;
}

/// Returns `count` letters, different for each number.
inline std::string letters_of(std::uint64_t number, std::size_t count) {
  std::mt19937_64 random(number);
  std::string text(count, ' ');
  for (char& letter : text) letter = static_cast<char>('a' + random() % 26);
  return text;
}

class Values {
 public:
  explicit Values(std::uint64_t number) : random_(number) {}

  template <class Number>
  std::enable_if_t<std::is_arithmetic_v<Number>> operator()(Number& number) {
    if constexpr (std::is_same_v<Number, bool>)
      number = below(2) == 1;
    else if constexpr (std::is_floating_point_v<Number>)
      number = static_cast<Number>(static_cast<double>(random_()) / 3e9);
    else
      number = static_cast<Number>(random_());
  }
  void operator()(std::string& text) { text = letters(); }
  void operator()(char*& text) { text = ::strdup(letters().c_str()); }
  template <class Sequence>
  void bytes(Sequence& sequence) {
    resize(sequence, below(5000));
    for (std::size_t i = 0; i < count_of(sequence); ++i)
      elements_of(sequence)[i] = static_cast<std::uint8_t>(random_());
  }
  template <class Sequence>
  void scan(Sequence& sequence) {
    resize(sequence, test::scan().size());
    std::copy(test::scan().begin(), test::scan().end(), elements_of(sequence));
  }
  template <class Sequence, class See>
  void each(Sequence& sequence, See see) {
    resize(sequence, below(6));
    for (std::size_t i = 0; i < count_of(sequence); ++i) see(*this, elements_of(sequence)[i]);
  }

 private:
  std::uint64_t below(std::uint64_t bound) { return random_() % bound; }
  std::string letters() {
    std::string text(8 + below(20), ' ');
    for (char& letter : text) letter = static_cast<char>('a' + below(26));
    return text;
  }

  std::mt19937_64 random_;
};

class Text {
 public:
  template <class Number>
  std::enable_if_t<std::is_arithmetic_v<Number>> operator()(const Number& number) {
    if constexpr (std::is_floating_point_v<Number>)
      out_ << std::hexfloat << number << ' ';
    else
      out_ << +number << ' ';
  }
  void operator()(const std::string& text) { out_ << '"' << text << "\" "; }
  void operator()(const char* text) { out_ << '"' << text << "\" "; }
  template <class Sequence>
  void bytes(const Sequence& sequence) {
    std::uint64_t hash = 14695981039346656037u;  // FNV-1a
    for (std::size_t i = 0; i < count_of(sequence); ++i)
      hash = (hash ^ static_cast<std::uint8_t>(elements_of(sequence)[i])) * 1099511628211u;
    out_ << count_of(sequence) << " bytes " << hash << ' ';
  }
  template <class Sequence>
  void scan(const Sequence& sequence) {
    bytes(sequence);
  }
  template <class Sequence, class See>
  void each(const Sequence& sequence, See see) {
    out_ << count_of(sequence) << ": ";
    for (std::size_t i = 0; i < count_of(sequence); ++i) see(*this, elements_of(sequence)[i]);
  }
  std::string said() const { return out_.str(); }

 private:
  std::ostringstream out_;
};

struct SeeString {
  template <class See, class M>
  void operator()(See& see, M& message) const {
    see(message.data);
  }
};
struct SeeHeader {
  template <class See, class M>
  void operator()(See& see, M& header) const {
    see(header.stamp.sec), see(header.stamp.nanosec), see(header.frame_id);
  }
};
struct SeeCloud {
  template <class See, class M>
  void operator()(See& see, M& cloud) const {
    SeeHeader()(see, cloud.header);
    see(cloud.height), see(cloud.width);
    see.each(cloud.fields, [](auto& own, auto& field) {
      own(field.name), own(field.offset), own(field.datatype), own(field.count);
    });
    see(cloud.is_bigendian), see(cloud.point_step), see(cloud.row_step);
    see.scan(cloud.data);
    see(cloud.is_dense);
  }
};
struct SeeXyz {
  template <class See, class M>
  void operator()(See& see, M& point) const {
    see(point.x), see(point.y), see(point.z);
  }
};
struct SeeColor {
  template <class See, class M>
  void operator()(See& see, M& color) const {
    see(color.r), see(color.g), see(color.b), see(color.a);
  }
};
struct SeeMarker {
  template <class See, class M>
  void operator()(See& see, M& marker) const {
    SeeHeader()(see, marker.header);
    see(marker.ns), see(marker.id), see(marker.type), see(marker.action);
    SeeXyz()(see, marker.pose.position);
    SeeXyz()(see, marker.pose.orientation), see(marker.pose.orientation.w);
    SeeXyz()(see, marker.scale);
    SeeColor()(see, marker.color);
    see(marker.lifetime.sec), see(marker.lifetime.nanosec), see(marker.frame_locked);
    see.each(marker.points, SeeXyz());
    see.each(marker.colors, SeeColor());
    see(marker.texture_resource);
    SeeHeader()(see, marker.texture.header);
    see(marker.texture.format), see.bytes(marker.texture.data);
    see.each(marker.uv_coordinates, [](auto& own, auto& at) { own(at.u), own(at.v); });
    see(marker.text), see(marker.mesh_resource);
    see(marker.mesh_file.filename), see.bytes(marker.mesh_file.data);
    see(marker.mesh_use_embedded_materials);
  }
};
struct SeeMarkers {
  template <class See, class M>
  void operator()(See& see, M& array) const {
    see.each(array.markers, SeeMarker());
  }
};

/// Fills a new `message` with that number's values.
template <class SeeType, class Message>
void set_values(std::uint64_t number, Message& message) {
  Values values(number);
  SeeType()(values, message);
}
template <class SeeType, class Message>
std::string text_of(const Message& message) {
  Text text;
  SeeType()(text, message);
  return text.said();
}

}  // namespace agnocast::test
