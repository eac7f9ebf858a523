// SPDX-License-Identifier: Apache-2.0
//
// Writes agnocastd(8) when the project is built, from the tables that --help and the reader of the
// configuration use.

#include <base/text/mdoc.hpp>
#include <daemon/config/config_keys.hpp>
#include <daemon/config/options.hpp>

#include <cstdio>
#include <fstream>
#include <string>

namespace agnocast::daemon {
namespace {

std::string options_section() {
  std::string text = ".Sh OPTIONS\n.Bl -tag -width Ds\n";
  for (const OptionText& option : option_texts()) {
    text += ".It " + mdoc::flags_of(option.name);
    if (!option.value.empty()) text += " Ar " + option.value;
    text += '\n' + mdoc::lines_of(option.meaning + '.');
  }
  return text + ".El\n";
}

std::string configuration_section() {
  std::string text =
      ".Sh CONFIGURATION\nA TOML file; every key may be left out.\n"
      ".Ic agnocastd --print-config\nprints all of them with the values in force.\n"
      ".Bl -tag -width Ds\n";
  for (const config_keys::Key& key : config_keys::all()) {
    text += ".It Va " + key.full() + '\n';
    if (!key.meaning.empty()) text += mdoc::lines_of(std::string(key.meaning) + '.');
  }
  return text + ".It Va access\nWho may use which topics: tables of an array.\n.El\n";
}

std::string manual(const std::string& date) {
  return mdoc::heading("agnocastd", "8", "the daemon of agnocast", date) +
         ".Sh SYNOPSIS\n.Nm\n.Op Ar option ...\n"
         ".Sh DESCRIPTION\n.Nm\n"
         "knows which process publishes or subscribes to what, makes the shared memory\n"
         "and hands out its descriptors, and repairs what a dead process left.\n"
         "It is never on the data path: while it is down, messages flow.\n"
         "It stays in the foreground.\n"
         ".Pp\nUnder systemd, which keeps its descriptors, it goes on after\n"
         ".Ic systemctl restart agnocastd\n"
         "as if nothing had happened;\n.Ic systemctl stop agnocastd\n"
         "gives up everything that it knew.\n" +
         options_section() + configuration_section() +
         ".Sh SIGNALS\n.Bl -tag -width Ds\n"
         ".It Dv SIGTERM , SIGINT\nEnd.\n"
         ".It Dv SIGHUP\nWithout systemd: start the program again, which keeps everything and\n"
         "reads the configuration anew.\n.El\n"
         ".Sh ENVIRONMENT\n.Bl -tag -width Ds\n"
         ".It Ev AGNOCAST_SOCKET\nThe socket, where there is no\n.Fl Fl socket .\n"
         ".It Ev NOTIFY_SOCKET , FDSTORE , LISTEN_FDS\nWhat a service manager says.\n.El\n"
         ".Sh FILES\n.Bl -tag -width Ds\n"
         ".It Pa /etc/agnocast/agnocastd.toml\nThe configuration.\n"
         ".It Pa /run/agnocast/agnocastd.sock\nThe socket of root's daemon.\n"
         "Who is in the group\n.Ql agnocast\nmay connect.\n"
         ".It Pa $XDG_RUNTIME_DIR/agnocast/agnocastd.sock\nThat of another user's.\n.El\n"
         ".Sh EXIT STATUS\n.Bl -tag -width Ds\n"
         ".It 0\nended by a signal, or what was asked for is printed.\n"
         ".It 1\nit cannot run here.\n.It 2\nwrong usage.\n.El\n"
         ".Sh SEE ALSO\n.Xr agnocast-ctl 1 ,\n.Xr agnocast-run 1 ,\n.Xr agnocast-errors 7\n";
}

}  // namespace
}  // namespace agnocast::daemon

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fputs("usage: agnocastd-manual-page DATE FILE\n", stderr);
    return 2;
  }
  std::ofstream file(argv[2]);
  return file << agnocast::daemon::manual(argv[1]) && file.flush() ? 0 : 1;
}
