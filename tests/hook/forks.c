/* SPDX-License-Identifier: Apache-2.0
 *
 * An ordinary C program that forks without exec, from threads too, and uses the heap in every
 * process.
 */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

static int child(int number) {
  char* text = NULL;
  for (int i = 0; i < 100; ++i) {
    text = realloc(text, (size_t)(i + 1) * 50);
    memset(text, 'a' + number % 26, (size_t)(i + 1) * 50);
  }
  const int good = text[4999] == 'a' + number % 26;
  free(text);
  return good ? 0 : 1;
}

static void* forking(void* argument) {
  int* const failures = argument;
  for (int i = 0; i < 30; ++i) {
    const pid_t pid = fork();
    if (pid == 0) _exit(child(i));
    int status = 1;
    waitpid(pid, &status, 0);
    *failures += status != 0;
    free(malloc((size_t)i * 1000));
  }
  return NULL;
}

int main(void) {
  pthread_t threads[3];
  int failures[3] = {0, 0, 0};
  for (int i = 0; i < 3; ++i) pthread_create(&threads[i], NULL, forking, &failures[i]);
  for (int i = 0; i < 3; ++i) pthread_join(threads[i], NULL);
  printf("failed children: %d\n", failures[0] + failures[1] + failures[2]);
  return failures[0] + failures[1] + failures[2];
}
