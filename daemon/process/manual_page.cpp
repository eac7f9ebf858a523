// SPDX-License-Identifier: Apache-2.0
//
// Writes agnocastd(8) at build time, from the tables of --help and of the configuration reader.

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
      ".Sh CONFIGURATION\nA TOML file; every key is optional.\n"
      ".Ic agnocastd --print-config\nprints all of them with their effective values.\n"
      ".Bl -tag -width Ds\n";
  for (const config_keys::Key& key : config_keys::all()) {
    text += ".It Va " + key.full() + '\n';
    if (!key.meaning.empty()) text += mdoc::lines_of(std::string(key.meaning) + '.');
  }
  return text +
         ".It Va access\nRules for topics: an array of tables.\n"
         ".It Va thread\nRules for the scheduling of threads that run callbacks: an array of "
         "tables.\n"
         ".Va process , node\nand\n.Va group\nare patterns of names,\n"
         ".Va users\nlists the users whose processes a rule is for, and\n"
         ".Va policy , priority , nice , runtime , deadline , period\nand\n.Va cpus\n"
         "are what it sets, as in\n.Xr sched 7 .\n"
         "The first rule that matches a callback group of the thread applies.\n.El\n";
}

std::string manual(const std::string& date) {
  return mdoc::heading("agnocastd", "8", "the daemon of agnocast", date) +
         ".Sh SYNOPSIS\n.Nm\n.Op Ar option ...\n"
         ".Sh DESCRIPTION\n.Nm\n"
         "registers publishers and subscriptions, makes the shared memory\n"
         "and hands out its descriptors, and cleans up after dead processes.\n"
         "It is never on the data path: while it is down, messages flow.\n"
         "It stays in the foreground.\n"
         ".Pp\nUnder systemd, which keeps its descriptors, it continues after\n"
         ".Ic systemctl restart agnocastd\n"
         "as if nothing had happened;\n.Ic systemctl stop agnocastd\n"
         "discards everything that it knew.\n" +
         options_section() + configuration_section() +
         ".Sh SIGNALS\n.Bl -tag -width Ds\n"
         ".It Dv SIGTERM , SIGINT\nEnds the daemon.\n"
         ".It Dv SIGHUP\nWithout systemd: restarts the program, which keeps everything and\n"
         "reads the configuration again.\n.El\n"
         ".Sh ENVIRONMENT\n.Bl -tag -width Ds\n"
         ".It Ev AGNOCAST_SOCKET\nThe socket, unless\n.Fl Fl socket\nis given.\n"
         ".It Ev NOTIFY_SOCKET , FDSTORE , LISTEN_FDS\nSet by a service manager.\n.El\n"
         ".Sh FILES\n.Bl -tag -width Ds\n"
         ".It Pa /etc/agnocast/agnocastd.toml\nThe configuration.\n"
         ".It Pa /run/agnocast/agnocastd.sock\nThe socket of root's daemon.\n"
         "Members of the group\n.Ql agnocast\nmay connect.\n"
         ".It Pa $XDG_RUNTIME_DIR/agnocast/agnocastd.sock\nThe socket of another user's "
         "daemon.\n.El\n"
         ".Sh EXIT STATUS\n.Bl -tag -width Ds\n"
         ".It 0\nended by a signal, or the requested text is printed.\n"
         ".It 1\nit cannot run here.\n.It 2\nwrong usage.\n.El\n"
         ".Sh SEE ALSO\n.Xr agnocast-ctl 1 ,\n.Xr agnocast-run 1 ,\n.Xr agnocast-errors 7 ,\n"
         ".Xr sched 7\n";
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
