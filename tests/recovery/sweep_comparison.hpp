// SPDX-License-Identifier: Apache-2.0
//
// Performance: compares a run with a death with the rehearsal.
#pragma once

#include <tests/recovery/sweep_script.hpp>

namespace agnocast::sweep {

inline std::string Performance::compare_answers(const Run& run) const {
  for (std::size_t i = 0; i < commands_.size(); ++i) {
    if (run.answers[i] != reference_.answers[i]) return differs(i, run.answers[i]);
  }
  return {};
}

inline std::string Performance::differs(std::size_t i, const std::string& answer) const {
  return "command " + std::to_string(i + 1) + " (" + commands_[i].who + " " + commands_[i].text +
         "): got '" + answer + "', without a death '" + reference_.answers[i] + "'";
}

inline std::string Performance::compare(const Run& run) const {
  if (!run.noticed_dead) return compare_answers(run);
  for (std::size_t i = 0; i < commands_.size(); ++i) {
    const Command& command = commands_[i];
    if (command.who == '*' || run.answers[i] == reference_.answers[i]) continue;
    if (command.who == 'V') {
      if (!run.answers[i].empty()) return differs(i, run.answers[i]);
      continue;
    }
    const bool is_judged = command.what == "take" || command.what == "drain" ||
                           command.what == "heard" ||
                           (command.what == "release" && run.answers[i] == "nothing");
    if (!is_judged) return differs(i, run.answers[i]);
  }
  for (const auto& [subscription, joined] : run.joined) {
    for (const auto& [publisher, whose] : publishers_) {
      if (const std::string wrong = judge(run, subscription, publisher); !wrong.empty())
        return wrong;
    }
  }
  return {};
}

inline std::string Performance::judge(const Run& run, std::uint64_t subscription,
                                      std::uint64_t publisher) const {
  const Run::Names got = names(run, subscription, publisher);
  const Run::Names wanted = names(reference_, subscription, publisher);
  const auto say = [&](const char* what) {
    std::string text = "subscription " + std::to_string(subscription) + " of publisher " +
                       std::to_string(publisher) + ": " + what + "; got";
    for (const std::uint64_t number : got) text += " " + std::to_string(number);
    text += ", without a death";
    for (const std::uint64_t number : wanted) text += " " + std::to_string(number);
    return text;
  };
  if (publishers_.at(publisher).owner != 'V')
    return got == wanted ? "" : say("a remaining peer's messages");
  const std::uint64_t acknowledged = number_in(run.acknowledged, publisher);
  if (got.size() > wanted.size() || !std::equal(got.begin(), got.end(), wanted.begin()))
    return say("no prefix");
  if (!got.empty() && got.back() > acknowledged + number_in(run.interrupted, publisher))
    return say("more than was published");
  const std::uint64_t committed = committed_by(run, publisher);
  const auto owed = static_cast<std::size_t>(std::count_if(
      wanted.begin(), wanted.end(), [&](std::uint64_t number) { return number <= committed; }));
  if (run.joined.at(subscription) < run.last_answer && got.size() < owed)
    return say("a committed message is missing");
  return {};
}

}  // namespace agnocast::sweep
