// SPDX-License-Identifier: Apache-2.0
//
// Goal: reading any message from another host ends, within the input, in a message or in a reason
// with its position. Method: the input is a type, the lengths of pieces, and bytes. A message that
// was read
//   - is the same however it was cut, also when read into a message with other content;
//   - can be written into memory of exactly its length, and reads back equal from there;
//   - is written to the same bytes again.
// Each piece is a separate allocation, so AddressSanitizer sees reads past its end.

#include <bridge/cdr/cdr.hpp>

#include <tests/support/messages/random_message.hpp>
#include <tests/support/schema_tables.hpp>
#include <tests/unit/bridge/pieces.hpp>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <vector>

namespace {

using namespace agnocast;
using test::Pieces;
using test::Schema;

void require(bool condition) {
  if (!condition) std::abort();
}

// One for each way in which members may be laid out; the corpus relies on the order.
const std::array<Schema, 8>& schemas() {
  static const std::array<Schema, 8> all = {{
      {{"Root",
        {{"stamp", "Time"},
         {"frame_id", "string"},
         {"height", "uint32"},
         {"width", "uint32"},
         {"fields", "Field[]"},
         {"is_bigendian", "bool"},
         {"point_step", "uint32"},
         {"row_step", "uint32"},
         {"data", "uint8[]"},
         {"is_dense", "bool"}}},
       {"Time", {{"sec", "int32"}, {"nanosec", "uint32"}}},
       {"Field",
        {{"name", "string"}, {"offset", "uint32"}, {"datatype", "uint8"}, {"count", "uint32"}}}},
      {{"Root", {{"gid", "Gid"}, {"nodes", "Node[]"}}},
       {"Gid", {{"data", "uint8[24]"}}},
       {"Node",
        {{"space", "string<=256"},
         {"name", "string<=256"},
         {"readers", "Gid[]"},
         {"writers", "Gid[]"}}}},
      {{"Root",
        {{"a", "wstring"}, {"b", "wstring[2]"}, {"c", "wstring<=3[<=3]"}, {"d", "wstring[]"}}}},
      {{"Root",
        {{"a", "bool"},
         {"list", "bool[]"},
         {"four", "bool[4]"},
         {"bounded", "bool[<=9]"},
         {"flags", "Flag[]"}}},
       {"Flag", {{"id", "uint32"}, {"a", "bool"}, {"b", "bool"}}}},
      {{"Root", {{"trees", "Tree[]"}}},
       {"Tree", {{"name", "string"}, {"branches", "Branch[]"}}},
       {"Branch", {{"leaves", "string[]"}, {"weights", "float64[]"}}}},
      {{"Root", {{"a", "Middle"}, {"list", "Middle[]"}, {"array", "Middle[3]"}}},
       {"Middle", {{"inner", "Nothing"}}},
       {"Nothing", {{"structure_needs_at_least_one_member", "uint8"}}}},
      {{"Root",
        {{"pad", "uint8"},
         {"a", "uint16[]"},
         {"p2", "uint8"},
         {"b", "uint32[]"},
         {"p3", "uint8"},
         {"c", "uint64[]"},
         {"tail", "Tail[]"},
         {"pair", "Tail[2]"},
         {"points", "Point[]"},
         {"poses", "Pose[<=4]"},
         {"rising", "Rising"}}},
       {"Tail", {{"x", "float64"}, {"y", "uint8"}}},
       {"Point", {{"x", "float32"}, {"y", "float32"}, {"z", "float32"}}},
       {"Pose", {{"position", "float64[3]"}, {"orientation", "float64[4]"}}},
       {"Rising", {{"a", "bool"}, {"b", "int16"}, {"c", "int32"}, {"d", "int64"}}}},
      {{"Root",
        {{"three", "string[3]"},
         {"any", "string[]"},
         {"bounded", "string<=5[<=2]"},
         {"text", "string<=5"}}}},
  }};
  return all;
}

struct Message {
  IntrospectedType type;
  bridge::CdrType cdr;
  OwnedGenericMessage memory = type.make();

  explicit Message(const MessageMembers& members)
      : type(members), cdr(bridge::CdrType::of(members).value()) {}
  bridge::CdrResult<std::size_t> read(const Pieces& pieces, bridge::ServiceHeader* header) const {
    return header != nullptr ? read_service_cdr(cdr, pieces.all(), *header, memory.get())
                             : read_cdr(cdr, pieces.all(), memory.get());
  }
  std::vector<std::byte> write(const bridge::ServiceHeader* header) const {
    std::vector<std::byte> bytes(header != nullptr ? service_cdr_bytes(cdr, memory.get())
                                                   : cdr_bytes(cdr, memory.get()));
    const auto written = header != nullptr ? write_service_cdr(cdr, *header, memory.get(), bytes)
                                           : write_cdr(cdr, memory.get(), bytes);
    require(written && *written == bytes.size());
    return bytes;
  }
  bool is_same_as(const Message& other) const {
    return test::are_same(type.members(), memory.get(), other.memory.get());
  }
};

/// Returns a message with content, the same for each input of the type.
const Message& something(const Schema& schema, const MessageMembers& members) {
  static std::map<const Schema*, Message> all;
  const auto [at, is_new] = all.try_emplace(&schema, members);
  // With few elements, as if nested.
  if (is_new) test::RandomMessages(1, {}).fill(members, at->second.memory.get(), 1);
  return at->second;
}

}  // namespace

// The low bits of the first byte are the type, its highest bit says whether there is a service
// header; then the number of pieces, as many lengths, and the payload.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const Schema& schema = schemas()[data[0] % schemas().size()];
  const bool has_header = data[0] >= 128;
  const std::size_t piece_count = std::min<std::size_t>(data[1] % 8, size - 2);
  const std::vector<std::size_t> lengths(data + 2, data + 2 + piece_count);
  const auto payload = std::as_bytes(std::span(data, size)).subspan(2 + piece_count);

  const MessageMembers& members = test::members_of_schema(schema, "Root");
  bridge::ServiceHeader headers[2];
  const auto header = [&](int index) { return has_header ? &headers[index] : nullptr; };

  const Message message(members);
  const auto read = message.read(Pieces(payload, lengths), header(0));
  const Message other(members);
  other.type.assign(something(schema, members).memory.get(), other.memory.get());
  const auto read_whole = other.read(Pieces(payload), header(1));
  require(read.has_value() == read_whole.has_value());
  if (!read) {
    require(read.error().text() == read_whole.error().text());
    require(read.error().byte <= payload.size());
    return 0;
  }
  require(*read == *read_whole && *read <= payload.size());
  require(headers[0] == headers[1] && message.is_same_as(other));

  const std::vector<std::byte> bytes = message.write(header(0));
  // An empty string may arrive without its zero, but is written with it.
  require(bytes.size() >= *read);
  const auto again = other.read(Pieces(bytes, lengths), header(1));
  require(again && *again == bytes.size());
  require(headers[0] == headers[1] && message.is_same_as(other));
  require(other.write(header(1)) == bytes);
  return 0;
}
