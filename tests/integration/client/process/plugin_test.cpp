// SPDX-License-Identifier: Apache-2.0
//
// Goal: a plugin that has published may be closed: its code destroys its messages later.
// Method: a host program that uses the library only through the plugin; a subscriber in another
// process keeps the message until the plugin is closed. Without the feature under test the
// library's own thread jumps into unmapped code. The plugin is built so that nothing else pins it
// (-fno-gnu-unique, plugin.map).

#include <tests/integration/client/programs/plugin.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/own_process.hpp>

#include <gmock/gmock.h>

#include <dlfcn.h>
#include <unistd.h>

#include <cstdlib>

namespace agnocast {
namespace {

using test::Child;

template <class Function>
Function symbol(void* plugin, const char* name) {
  return reinterpret_cast<Function>(::dlsym(plugin, name));
}

TEST(Plugin, MayBeClosedWhileItsMessagesAreHeldElsewhere) {
  test::DaemonProcess daemon;
  ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
  int said[2], wait[2];
  ASSERT_EQ(::pipe(said), 0);
  ASSERT_EQ(::pipe(wait), 0);
  Child subscriber([&]() noexcept {
    ::close(wait[1]);
    void* const plugin = ::dlopen(AGNOCAST_TEST_PLUGIN, RTLD_NOW);
    return plugin != nullptr ? symbol<PluginHold>(plugin, "plugin_hold")(said[1], wait[0]) : 1;
  });
  ::close(said[1]);  // reading it ends when the subscriber does
  EXPECT_TRUE(test::in_own_process([&] {
    void* const plugin = ::dlopen(AGNOCAST_TEST_PLUGIN, RTLD_NOW);
    ASSERT_NE(plugin, nullptr) << ::dlerror();
    static std::atomic<int> destroyed{0};
    char byte = 0;
    ASSERT_EQ(::read(said[0], &byte, 1), 1) << "the subscription exists before the publisher";
    void* const publisher = symbol<PluginStart>(plugin, "plugin_start")(&destroyed);
    ASSERT_NE(publisher, nullptr);
    ASSERT_EQ(::read(said[0], &byte, 1), 1) << "the subscriber holds it";
    symbol<PluginStop>(plugin, "plugin_stop")(publisher);
    ASSERT_EQ(::dlclose(plugin), 0);
    EXPECT_EQ(destroyed, 0) << "it is held";
    ASSERT_EQ(::write(wait[1], &byte, 1), 1);
    EXPECT_TRUE(test::eventually([] { return destroyed == 1; }));
  }));
  ::close(wait[1]);
  EXPECT_EQ(subscriber.wait(), 0);
}

}  // namespace
}  // namespace agnocast
