// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/refusals.hpp>

#include <agnocast/error.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/console.hpp>
#include <ctl/snapshot/journal.hpp>

namespace agnocast::ctl {

std::string refusal_words(const wire::DumpRefusal& refusal) {
  std::string text = std::string(word_of(static_cast<Errc>(refusal.code))) + ": ";
  if (const std::string topic = text_of(refusal.topic); !topic.empty())
    text += std::string(refusal.kind == wire::Kind::publisher ? "publisher" : "subscription") +
            " of " + escaped(topic) + ": ";
  return text + escaped(text_of(refusal.why)) + " (" + duration_for_people(refusal.age_ns) +
         " ago" + (refusal.times > 1 ? ", " + std::to_string(refusal.times) + " times" : "") + ")";
}

}  // namespace agnocast::ctl
