// SPDX-License-Identifier: Apache-2.0
//
// explain: the meaning, usual cause and remedy of an error code, from the one table of errors
// (include/agnocast/error.hpp). Works without a daemon.

#include <agnocast/error.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>

#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {
namespace {

constexpr Errc codes[] = {
#define AGNOCAST_CODE(name, sentence, cause, remedy) Errc::name,
    AGNOCAST_ERROR_TABLE(AGNOCAST_CODE)
#undef AGNOCAST_CODE
};

Object object_of(Errc code) {
  return {{"code", word_of(code)},
          {"number", static_cast<int>(code)},
          {"sentence", sentence_of(code)},
          {"cause", cause_of(code)},
          {"remedy", remedy_of(code)}};
}

/// Finds a code by its word or its number.
Outcome<Errc> code_of(const std::string& name) {
  std::vector<std::string_view> words;
  for (const Errc code : codes) {
    if (name == word_of(code) || name == std::to_string(static_cast<int>(code))) return code;
    words.emplace_back(word_of(code));
  }
  const std::string_view meant = nearest(name, words);
  return problem(
      Status::no_such_thing, escaped(name),
      "there is no such code" +
          (meant.empty() ? std::string() : "; did you mean " + std::string(meant) + "?"),
      meant.empty() ? "agnocast-ctl explain" : "agnocast-ctl explain " + std::string(meant));
}

}  // namespace

Outcome<void> explain_code(const Arguments& arguments, Console& console) {
  if (arguments.subjects.empty()) {
    if (arguments.json == Json::no) {
      Table table({"CODE", "MEANING"});
      for (const Errc code : codes) table.add({word_of(code), sentence_of(code)});
      table.print(console);
      return {};
    }
    Object list = Object::array();
    for (const Errc code : codes) list.push_back(object_of(code));
    console.object({{"schema", "agnocast.explain/1"}, {"codes", list}}, arguments.json);
    return {};
  }
  const auto code = code_of(arguments.subject(0));
  if (!code) return tl::unexpected(code.error());
  if (arguments.json != Json::no) {
    console.object({{"schema", "agnocast.explain/1"}, {"codes", Object::array({object_of(*code)})}},
                   arguments.json);
    return {};
  }
  console.line(console.strong(word_of(*code)) + " (" + std::to_string(static_cast<int>(*code)) +
               ")");
  console.line(std::string("  what    ") + sentence_of(*code));
  console.line(std::string("  why     ") + cause_of(*code));
  console.line(std::string("  remedy  ") + remedy_of(*code));
  return {};
}

}  // namespace agnocast::ctl
