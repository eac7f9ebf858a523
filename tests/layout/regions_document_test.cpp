// SPDX-License-Identifier: Apache-2.0
//
// Goal: docs/regions.md agrees with the headers. Method: compare the offset, name and size of
// every field, taken from the compiler, with the first three columns of the table under the
// heading that names the struct; every heading must name a struct of this list, and every gap
// between two fields must be an alignment.

#include <agnocast/abi/board.hpp>
#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/graph_table.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::abi {
namespace {

struct Struct {
  std::size_t bytes;
  std::vector<std::string> fields;  // "offset name bytes"
  bool operator==(const Struct&) const = default;
};

std::ostream& operator<<(std::ostream& out, const Struct& it) {
  out << it.bytes << " bytes\n";
  for (const std::string& field : it.fields) out << "    " << field << '\n';
  return out;
}

#define FIELD(type, name) \
  std::to_string(offsetof(type, name)) + " " #name " " + std::to_string(sizeof(type::name))
#define STRUCT(type, ...)           \
  {                                 \
#type, {                        \
      sizeof(type), { __VA_ARGS__ } \
    }                               \
  }

std::map<std::string, Struct> in_headers() {
  return {
      STRUCT(BoardHeader, FIELD(BoardHeader, magic), FIELD(BoardHeader, fingerprint),
             FIELD(BoardHeader, incarnation)),
      STRUCT(TopicHeader, FIELD(TopicHeader, epoch), FIELD(TopicHeader, word),
             FIELD(TopicHeader, publisher_high), FIELD(TopicHeader, subscription_high)),
      STRUCT(PublisherEntry, FIELD(PublisherEntry, word), FIELD(PublisherEntry, policies),
             FIELD(PublisherEntry, client), FIELD(PublisherEntry, extent),
             FIELD(PublisherEntry, slot_count), FIELD(PublisherEntry, final_head),
             FIELD(PublisherEntry, deadline_ns), FIELD(PublisherEntry, lease_ns)),
      STRUCT(SubscriptionEntry, FIELD(SubscriptionEntry, word), FIELD(SubscriptionEntry, policies),
             FIELD(SubscriptionEntry, client), FIELD(SubscriptionEntry, extent),
             FIELD(SubscriptionEntry, quota), FIELD(SubscriptionEntry, wait_set),
             FIELD(SubscriptionEntry, deadline_ns), FIELD(SubscriptionEntry, lease_ns)),
      STRUCT(ClientRegionHeader, FIELD(ClientRegionHeader, magic),
             FIELD(ClientRegionHeader, fingerprint), FIELD(ClientRegionHeader, generation),
             FIELD(ClientRegionHeader, window), FIELD(ClientRegionHeader, reserved),
             FIELD(ClientRegionHeader, wait_set)),
      STRUCT(WindowEntry, FIELD(WindowEntry, base), FIELD(WindowEntry, length),
             FIELD(WindowEntry, frontier), FIELD(WindowEntry, reserved)),
      STRUCT(WaitSetLine, FIELD(WaitSetLine, armed)),
      STRUCT(PublisherEndpoint, FIELD(PublisherEndpoint, head),
             FIELD(PublisherEndpoint, persistent_id), FIELD(PublisherEndpoint, inherited),
             FIELD(PublisherEndpoint, published_bytes), FIELD(PublisherEndpoint, asserted_ns),
             FIELD(PublisherEndpoint, intent_op), FIELD(PublisherEndpoint, intent_sequence),
             FIELD(PublisherEndpoint, intent_slot), FIELD(PublisherEndpoint, adopted_messages),
             FIELD(PublisherEndpoint, adopted_bytes), FIELD(PublisherEndpoint, refused_no_slot),
             FIELD(PublisherEndpoint, refused_would_block),
             FIELD(PublisherEndpoint, refused_heap_exhausted), FIELD(PublisherEndpoint, withdrawn)),
      STRUCT(QueueSlot, FIELD(QueueSlot, id), FIELD(QueueSlot, address), FIELD(QueueSlot, stamp_ns),
             FIELD(QueueSlot, size)),
      STRUCT(LinkLine, FIELD(LinkLine, publisher_generation), FIELD(LinkLine, cursor),
             FIELD(LinkLine, hold)),
      STRUCT(SubscriptionCounters, FIELD(SubscriptionCounters, lost),
             FIELD(SubscriptionCounters, malformed), FIELD(SubscriptionCounters, unreachable),
             FIELD(SubscriptionCounters, persistent_id), FIELD(SubscriptionCounters, expired)),
      STRUCT(GraphHeader, FIELD(GraphHeader, magic), FIELD(GraphHeader, fingerprint),
             FIELD(GraphHeader, incarnation), FIELD(GraphHeader, changes),
             FIELD(GraphHeader, entry_high), FIELD(GraphHeader, missing)),
      STRUCT(GraphEntry, FIELD(GraphEntry, word), FIELD(GraphEntry, kind),
             FIELD(GraphEntry, domain), FIELD(GraphEntry, layout_hash), FIELD(GraphEntry, policies),
             FIELD(GraphEntry, deadline_ns), FIELD(GraphEntry, lifespan_ns),
             FIELD(GraphEntry, lease_ns), FIELD(GraphEntry, client), FIELD(GraphEntry, pid),
             FIELD(GraphEntry, uid), FIELD(GraphEntry, reserved), FIELD(GraphEntry, topic),
             FIELD(GraphEntry, type), FIELD(GraphEntry, node), FIELD(GraphEntry, process)),
  };
}

std::string document() {
  std::ifstream file(AGNOCAST_REGIONS_DOCUMENT);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

std::map<std::string, Struct> in_document() {
  std::map<std::string, Struct> found;
  Struct* current = nullptr;
  std::istringstream lines(document());
  for (std::string line; std::getline(lines, line);) {
    char name[64] = {};
    std::size_t offset = 0, bytes = 0;
    if (std::sscanf(line.c_str(), "### `%63[A-Za-z0-9_]`, %zu bytes", name, &bytes) == 2) {
      current = &found[name];
      current->bytes = bytes;
    } else if (line.rfind("#", 0) == 0) {
      current = nullptr;
    } else if (current != nullptr && std::sscanf(line.c_str(), "| %zu | `%63[A-Za-z0-9_]` | %zu |",
                                                 &offset, name, &bytes) == 3) {
      current->fields.push_back(std::to_string(offset) + " " + name + " " + std::to_string(bytes));
    }
  }
  return found;
}

TEST(RegionsDocument, HasTheFieldsOfTheHeaders) {
  const auto documented = in_document();
  for (const auto& [name, fields] : in_headers()) {
    ASSERT_TRUE(documented.contains(name)) << "docs/regions.md has no table of " << name;
    EXPECT_EQ(documented.at(name), fields) << name;
  }
  EXPECT_EQ(documented.size(), in_headers().size());
}

TEST(RegionsDocument, OmitsNoField) {
  for (const auto& [name, it] : in_headers()) {
    std::size_t end = 0;
    for (const std::string& field : it.fields) {
      std::istringstream words(field);
      std::size_t offset = 0, bytes = 0;
      std::string label;
      words >> offset >> label >> bytes;
      EXPECT_TRUE(offset == end || offset % cache_line_bytes == 0) << name << ' ' << field;
      EXPECT_GE(offset, end) << name << ' ' << field;
      end = offset + bytes;
    }
    EXPECT_LE(it.bytes - end, cache_line_bytes) << name << ": a field is missing at the end";
  }
}

TEST(RegionsDocument, HasTheLimitsOfTheHeaders) {
  const std::string text = document();
  const auto says = [&](const std::string& words) { EXPECT_THAT(text, testing::HasSubstr(words)); };
  const auto number = [](std::uint64_t value) { return std::to_string(value); };
  says("| board | 1 | the daemon | every client, observers | " + number(page_bytes) + " + " +
       number(topic_count_max) + " topics × " + number(topic_bytes) + " bytes |");
  says("| 4096 + " + number(sizeof(GraphEntry)) + " bytes for each of up to " +
       number(graph_entry_max) + " endpoints |");
  says("in blocks of " + number(graph_block_entries) + ":");
  says("heap window | 1 to " + number(window_count_max) + " for each");
  says(number(topic_offset(0)) + "  topic 0:  TopicHeader · PublisherEntry[" +
       number(publisher_count_max) + "] · SubscriptionEntry[" + number(subscription_count_max) +
       "]");
  says(number(topic_offset(1)) + "  topic 1");
  says("order ring [" + number(ring_count) + "] · QueueSlot[" + number(slot_count_max) + "]");
  says("SubscriptionCounters, in a page of its own · link blocks [1 or " + number(link_block_max) +
       "]");
  says("LinkLine[" + number(link_block_count) + "] · " +
       number(link_block_bytes / link_part_bytes - 1) + " × further hold words [" +
       number(link_block_count) + "][" + number(hold_words_per_line) + "]");
  says("`WindowEntry[" + number(window_count_max) + "]`");
  says("`WaitSetLine[" + number(wait_set_count_max) + "]`");
  says("slots 0 to " + number(near_slot_count - 1) + ";");
  says("multiple of " + number(window_granule_bytes >> 20) + " MiB");
}

}  // namespace
}  // namespace agnocast::abi
