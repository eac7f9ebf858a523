// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/manual.hpp>

#include <agnocast/error.hpp>
#include <base/text/mdoc.hpp>
#include <ctl/cli/help.hpp>

#include <string_view>
#include <vector>

namespace agnocast::ctl {
namespace {

using mdoc::heading;
using mdoc::lines_of;
using mdoc::plain;

/// Returns ".It Fl n , Fl Fl number Ar COUNT".
std::string item_of(const Option& option) {
  std::string item = ".It " + mdoc::flags_of(option.names);
  if (option.value.starts_with('[')) {
    item +=
        " Ns Oo = Ns Ar " + std::string(option.value.substr(2, option.value.size() - 3)) + " Oc";
  } else if (!option.value.empty()) {
    item += " Ar " + std::string(option.value);
  }
  return item + '\n';
}

std::string list_of(std::span<const Option* const> options) {
  std::string text = ".Bl -tag -width Ds\n";
  for (const Option* const option : options) {
    text += item_of(*option) + lines_of(meaning_of(*option) + '.');
  }
  return text + ".El\n";
}

std::string section_of(const Command& command) {
  std::string text = ".Ss " + usage_of(command) + "\\&\n" + lines_of(command.description);
  if (!command.subjects.empty()) {
    text += ".Bl -tag -width Ds\n";
    for (const Subject* const subject : command.subjects)
      text += ".It Ar " + std::string(subject->name) + '\n' +
              lines_of(std::string(subject->meaning) + '.');
    text += ".El\n";
  }
  if (!command.options.empty()) text += list_of(command.options);
  std::string_view examples = command.examples;
  text += ".Pp\n";
  while (!examples.empty()) {
    const std::size_t end = examples.find('\n');
    text += ".Dl " + plain(examples.substr(0, end)) + '\n';
    examples.remove_prefix(end == std::string_view::npos ? examples.size() : end + 1);
  }
  return text;
}

}  // namespace

std::string manual_of(std::span<const Command> commands, const std::string& date) {
  std::string text = heading("agnocast-ctl", "1", "inspect and administer agnocast", date);
  text +=
      ".Sh SYNOPSIS\n.Nm\n.Ar noun\n.Op Ar verb\n.Op Ar name ...\n.Op Ar option ...\n"
      ".Sh DESCRIPTION\n.Nm\ninspects topics, nodes, processes, messages and shared heaps.\n" +
      lines_of(
          "A command changes nothing and subscribes to nothing unless its description says so.") +
      "A plural noun is short for its list:\n.Cm topics\nis\n.Cm topic list .\n"
      ".Sh OPTIONS\nAll commands take these options.\n" +
      list_of(common_options()) + ".Sh COMMANDS\n";
  for (const Command& command : commands) text += section_of(command);
  return text +
         ".Sh ENVIRONMENT\n.Bl -tag -width Ds\n"
         ".It Ev AGNOCAST_SOCKET\nthe socket of agnocastd.\n"
         ".It Ev ROS_DOMAIN_ID\nthe ROS domain; default: 0.\n"
         ".It Ev NO_COLOR\ndisables bold headings on a terminal.\n.El\n"
         ".Sh EXIT STATUS\n.Bl -tag -width Ds\n"
         ".It 0\ndone.\n.It 1\nfailed.\n.It 2\nwrong usage.\n.It 3\nthe daemon cannot be reached.\n"
         ".It 4\nno such topic, node or process.\n.It 5\npermission denied.\n"
         ".It 6\na check failed.\n.It 124\ntimed out.\n.El\n"
         ".Sh SEE ALSO\n.Xr agnocast-run 1 ,\n.Xr agnocast-errors 7 ,\n.Xr agnocastd 8\n";
}

std::string manual_of_errors(const std::string& date) {
  std::string text =
      heading("agnocast-errors", "7", "errors of agnocast, their causes and remedies", date) +
      ".Sh DESCRIPTION\nEvery error that a user can see has a code.\nPrograms print the sentence "
      "and the "
      "remedy;\n.Ql agnocast-ctl explain CODE\nprints the entry below.\n.Bl -tag -width Ds\n";
  constexpr Errc codes[] = {
#define AGNOCAST_CODE(name, sentence, cause, remedy) Errc::name,
      AGNOCAST_ERROR_TABLE(AGNOCAST_CODE)
#undef AGNOCAST_CODE
  };
  for (const Errc code : codes)
    text += ".It Er " + std::string(word_of(code)) + '\n' +
            lines_of(std::string(sentence_of(code)) + ".") +
            lines_of("Usually because " + std::string(cause_of(code)) + ".") +
            lines_of("What to do: " + std::string(remedy_of(code)) + ".");
  return text + ".El\n.Sh SEE ALSO\n.Xr agnocast-ctl 1\n";
}

}  // namespace agnocast::ctl
