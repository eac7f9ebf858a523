// SPDX-License-Identifier: Apache-2.0
//
// Goal: a forked child reads the parent's messages, cannot change them, and allocates from libc;
// fork never deadlocks, whichever threads allocate meanwhile; vfork, posix_spawn and exec are
// unaffected. Method: children report by exit status, and a second mapping of the memfd acts as a
// reader.

#include "support.hpp"

#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <malloc.h>
#include <pthread.h>
#include <signal.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

extern char** environ;

namespace {

using namespace hook_test;

struct Message {
  std::vector<int> numbers;
  std::string name;
};

Message* make_message() {
  Scope scope;
  auto* const message = new Message;
  for (int i = 0; i < 100000; ++i) message->numbers.push_back(i);
  message->name = std::string(100, 'm');
  return message;
}

bool intact(const Message& message) {
  if (message.numbers.size() != 100000 || message.name != std::string(100, 'm')) return false;
  for (int i = 0; i < 100000; ++i) {
    if (message.numbers[static_cast<std::size_t>(i)] != i) return false;
  }
  return true;
}

bool libc_block(std::size_t size) {
  Scope scope;
  void* const block = opaque(malloc(size));
  const bool ours = is_shared(block);
  std::memset(block, 1, size);
  free(block);
  return !ours;
}

HOOKED_TEST(HookFork, TheChildReadsTheMessageAndKeepsItsWritesToItself) {
  WindowFile file(256 * MiB);
  attach(file);
  Message* const message = make_message();
  const std::size_t offset =
      reinterpret_cast<std::uintptr_t>(message->numbers.data()) - window_address;
  const auto* const reader = static_cast<const char*>(
      mmap(nullptr, 64 * MiB, PROT_READ, MAP_SHARED, file.window.read_fd, 0));
  EXPECT_EQ(in_forked_child([&] {
              if (!intact(*message) || !is_shared(message)) return false;
              for (int& number : message->numbers) number = -1;
              message->name = "changed by the child";
              return message->numbers[5] == -1;
            }),
            0);
  EXPECT_TRUE(intact(*message));
  EXPECT_EQ(std::memcmp(reader + offset, message->numbers.data(), 400000), 0);
  delete message;
}

HOOKED_TEST(HookFork, TheChildUsesLibcAndLeavesSharedBlocksAlone) {
  WindowFile file(256 * MiB);
  attach(file);
  Message* const message = make_message();
  const std::uint64_t used = hook_test::usage().used_bytes;
  hook().enter();  // the child inherits an open scope
  EXPECT_EQ(
      in_forked_child([&] {
        if (hook().active() != 0) return false;
        if (!libc_block(10) || !libc_block(5000000)) return false;
        if (malloc_usable_size(message->numbers.data()) < 400000) return false;
        delete message;  // nothing
        char* text = static_cast<char*>(nullptr);
        text = static_cast<char*>(realloc(message->name.data(), 4000));
        if (text == nullptr || is_shared(text) || std::string(text, 100) != std::string(100, 'm'))
          return false;
        free(text);
        return hook_test::usage().internal_error_count == 0;
      }),
      0);
  hook().leave();
  EXPECT_TRUE(intact(*message));
  EXPECT_EQ(hook_test::usage().used_bytes, used);
  delete message;
}

HOOKED_TEST(HookFork, TheChildIsDetachedForGood) {
  WindowFile file(64 * MiB);
  WindowFile second(64 * MiB, window_address + (std::uintptr_t{1} << 30));
  attach(file);
  EXPECT_EQ(in_forked_child([&] {
              const agnocast_heaphook_options options = options_for(AGNOCAST_HEAPHOOK_SCOPE_LOAN);
              return hook().attach(&second.window, &options) == AGNOCAST_HEAPHOOK_FORKED &&
                     hook().add_window(&second.window) == AGNOCAST_HEAPHOOK_FORKED &&
                     hook().purge() == 0;
            }),
            0);
}

HOOKED_TEST(HookFork, AForkBeforeAttachHasNoEffect) {
  WindowFile file(64 * MiB);
  EXPECT_EQ(in_forked_child([&] {
              const agnocast_heaphook_options options = options_for(AGNOCAST_HEAPHOOK_SCOPE_LOAN);
              if (hook().attach(&file.window, &options) != AGNOCAST_HEAPHOOK_OK) return false;
              Scope scope;
              return is_shared(opaque(malloc(100)));
            }),
            0);
}

HOOKED_TEST(HookFork, AChildOfAChildInheritsTheChildsView) {
  WindowFile file(256 * MiB);
  attach(file);
  Message* const message = make_message();
  EXPECT_EQ(in_forked_child([&] {
              message->numbers[7] = 1234567;
              const int grandchild = in_forked_child([&] {
                if (message->numbers[7] != 1234567 || message->numbers[8] != 8 || !libc_block(1000))
                  return false;
                message->numbers[7] = 7654321;
                delete message;
                return true;
              });
              return grandchild == 0 && message->numbers[7] == 1234567;
            }),
            0);
  EXPECT_TRUE(intact(*message));
  delete message;
}

HOOKED_TEST(HookFork, ScopeAllForksTheSameWay) {
  WindowFile file(256 * MiB);
  attach(file, AGNOCAST_HEAPHOOK_SCOPE_ALL);
  const std::string before(500, 'b');
  ASSERT_TRUE(is_shared(before.data()));
  EXPECT_EQ(in_forked_child([&] {
              const std::string after(500, 'a');
              return before == std::string(500, 'b') && !is_shared(after.data());
            }),
            0);
}

// The hook registers its fork handlers at attach. These are registered before, so their prepare
// half runs when the allocator is already locked and their parent half before it is unlocked.
void* early_block = nullptr;
int early_runs = 0;
bool early_wrong = false;
void early_handler() {
  ++early_runs;
  Scope scope;
  void* const block = opaque(malloc(5000));
  if (is_shared(block)) early_wrong = true;
  free(block);
  free(early_block);  // shared
  early_block = nullptr;
}

HOOKED_TEST(HookFork, HandlersOfOthersMayAllocateAndFreeWhileTheHeapIsLocked) {
  pthread_atfork(early_handler, early_handler, early_handler);
  WindowFile file(64 * MiB);
  attach(file);
  const std::uint64_t before = hook_test::usage().live_bytes;
  for (int i = 0; i < 20; ++i) {
    hook().enter();
    early_block = malloc(i % 2 == 0 ? 8 : 100000);
    EXPECT_EQ(in_forked_child([] { return !early_wrong && early_runs % 2 == 0; }), 0);
    hook().leave();
  }
  EXPECT_EQ(early_runs, 40);
  EXPECT_FALSE(early_wrong);
  EXPECT_EQ(hook_test::usage().live_bytes, before) << "the handlers' frees took effect";
}

HOOKED_TEST(HookFork, ForkWhileOthersAllocateNeverDeadlocks) {
  WindowFile file(4096 * MiB);
  attach(file);
  Message* const message = make_message();
  std::atomic<bool> stop{false};
  std::vector<std::thread> threads;
  for (unsigned t = 0; t < 3; ++t) {
    threads.emplace_back([&, t] {
      std::uint64_t random = t + 1;
      std::vector<void*> kept;
      kept.reserve(64);
      while (!stop) {
        Scope scope;
        random = random * 6364136223846793005u + 1442695040888963407u;
        const std::size_t size = (random >> 33) % ((random >> 60) == 0 ? 3 * MiB : 2000);
        if (kept.size() == 64) {
          for (void* block : kept) free(block);
          kept.clear();
        }
        kept.push_back(malloc(size));
        if (t == 2 && (random >> 40) % 64 == 0) hook().purge();
      }
      for (void* block : kept) free(block);
    });
  }
  for (int i = 0; i < 300; ++i) {
    if (i % 2 == 0) hook().enter();
    const int status = in_forked_child([&] {
      if (!intact(*message) || !libc_block(100) || !libc_block(100000)) return false;
      void* const moved = realloc(message->numbers.data(), 800000);
      return moved != nullptr && !is_shared(moved);
    });
    if (i % 2 == 0) hook().leave();
    ASSERT_EQ(status, 0) << "fork number " << i;
  }
  stop = true;
  for (std::thread& thread : threads) thread.join();
  EXPECT_TRUE(intact(*message));
  EXPECT_EQ(hook_test::usage().internal_error_count, 0u);
}

HOOKED_TEST(HookFork, EveryEntryPointWorksAsTheFirstActOfAChild) {
  WindowFile file(256 * MiB);
  attach(file);
  hook().enter();
  void* const shared = malloc(1000);
  std::memset(shared, 9, 1000);
  const auto good = [](void* block) { return block != nullptr && !is_shared(block); };
  EXPECT_EQ(in_forked_child([&] { return good(malloc(100)); }), 0);
  EXPECT_EQ(in_forked_child([&] { return good(calloc(10, 10)); }), 0);
  EXPECT_EQ(in_forked_child([&] { return good(realloc(nullptr, 100)); }), 0);
  EXPECT_EQ(in_forked_child([&] {
              auto* const moved = static_cast<char*>(realloc(shared, 2000));
              return good(moved) && moved[999] == 9;
            }),
            0);
  EXPECT_EQ(in_forked_child([&] { return good(reallocarray(shared, 20, 100)); }), 0);
  EXPECT_EQ(in_forked_child([&] { return realloc(shared, 0) == nullptr; }), 0);
  EXPECT_EQ(in_forked_child([&] {
              free(shared);
              return true;
            }),
            0);
  EXPECT_EQ(in_forked_child([&] {
              operator delete(shared);
              return true;
            }),
            0);
  EXPECT_EQ(in_forked_child([&] { return malloc_usable_size(shared) >= 1000; }), 0);
  EXPECT_EQ(in_forked_child([&] {
              void* block = nullptr;
              return posix_memalign(&block, 64, 100) == 0 && good(block);
            }),
            0);
  EXPECT_EQ(in_forked_child([&] { return good(aligned_alloc(64, 128)); }), 0);
  EXPECT_EQ(in_forked_child([&] { return good(memalign(64, 100)); }), 0);
  EXPECT_EQ(in_forked_child([&] { return good(valloc(100)); }), 0);
  EXPECT_EQ(in_forked_child([&] { return good(pvalloc(100)); }), 0);
  EXPECT_EQ(in_forked_child([&] { return good(operator new(100)); }), 0);
  EXPECT_EQ(in_forked_child([&] { return good(operator new (100, std::align_val_t{64})); }), 0);
  EXPECT_EQ(in_forked_child([&] { return hook().owns(shared) == 1; }), 0);
  EXPECT_EQ(in_forked_child([&] { return hook().purge() == 0; }), 0);
  EXPECT_EQ(in_forked_child([&] { return hook_test::usage().window_count == 1; }), 0);
  hook().leave();
  free(shared);
}

HOOKED_TEST(HookFork, AChildWhoseDescriptorsWereClosedStillRunsOnLibc) {
  WindowFile file(64 * MiB);
  attach(file);
  Message* const message = make_message();
  for (int fd = 3; fd < 100; ++fd) close(fd);
  EXPECT_EQ(in_forked_child([&] {
              free(message);  // ignored without reading it
              return libc_block(1000) && hook_test::usage().mapping_refused_count == 1;
            }),
            0);
  EXPECT_TRUE(intact(*message));
}

// Children that skip the fork handlers: they own nothing and can do no harm.
HOOKED_TEST(HookFork, ARawCloneOwnsNothing) {
  WindowFile file(64 * MiB);
  attach(file);
  Message* const message = make_message();
  hook().enter();
  const auto pid = static_cast<int>(syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0));
  if (pid == 0) {
    free(message);
    void* const block = malloc(100);
    _exit(block != nullptr && !is_shared(block) ? 0 : 1);
  }
  hook().leave();
  EXPECT_EQ(wait_for(pid), 0);
  EXPECT_TRUE(intact(*message));

  const auto writer = static_cast<int>(syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0));
  if (writer == 0) {
    message->numbers[0] = 99;  // faults: no window here
    _exit(0);
  }
  EXPECT_EQ(wait_for(writer), 128 + SIGSEGV);
  EXPECT_TRUE(intact(*message));
}

[[gnu::noinline]] pid_t vfork_true() {
  const pid_t child = vfork();
  if (child == 0) {
    execl("/bin/true", "true", nullptr);
    _exit(127);
  }
  return child;
}

HOOKED_TEST(HookFork, VforkSpawnAndExecAreUnaffected) {
  WindowFile file(64 * MiB);
  attach(file);
  Message* const message = make_message();
  const std::uint64_t errors = hook_test::usage().internal_error_count;
  for (int i = 0; i < 20; ++i) {
    hook().enter();
    EXPECT_EQ(wait_for(vfork_true()), 0);

    pid_t spawned = 0;
    std::string path = "/bin/sh";
    char script[] = "exit 7";
    char flag[] = "-c";
    char* arguments[] = {path.data(), flag, script, nullptr};
    ASSERT_EQ(posix_spawn(&spawned, path.c_str(), nullptr, nullptr, arguments, environ), 0);
    EXPECT_EQ(wait_for(spawned), 7);
    EXPECT_TRUE(is_shared(std::unique_ptr<char[]>(new char[100]).get()))
        << "the scope is unchanged";
    hook().leave();

    EXPECT_EQ(in_forked_child([] { return execl("/bin/true", "true", nullptr) == 0; }), 0);
    EXPECT_EQ(system("exit 3") >> 8, 3);
    FILE* const pipe = popen("echo hello", "r");
    char text[20] = {};
    EXPECT_NE(fgets(text, sizeof text, pipe), nullptr);
    EXPECT_STREQ(text, "hello\n");
    EXPECT_EQ(pclose(pipe), 0);
  }
  EXPECT_TRUE(intact(*message));
  EXPECT_EQ(hook_test::usage().internal_error_count, errors);
}

HOOKED_TEST(HookFork, ExecInheritsNoDescriptorsOfTheHook) {
  WindowFile file(64 * MiB);
  attach(file);
  FILE* const pipe = popen("readlink /proc/self/fd/* | grep -c memfd", "r");
  char text[20] = {};
  ASSERT_NE(fgets(text, sizeof text, pipe), nullptr);
  EXPECT_STREQ(text, "0\n");
  pclose(pipe);
}

}  // namespace
