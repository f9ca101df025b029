/* Tests that enter themselves into the list of all; each stops the program if it fails. */
#ifndef FLEXFMU_TESTS_H
#define FLEXFMU_TESTS_H

typedef struct test {
  const char *name;
  void (*run)(void);
  struct test *next;
} test;

extern test *all_tests;

/* the name says what the test protects, the comment before it why */
#define TEST(NAME)                                                      \
  static void test_##NAME(void);                                        \
  __attribute__((constructor)) static void enter_##NAME(void) {         \
    static test own = {#NAME, test_##NAME, 0};                          \
    own.next = all_tests, all_tests = &own;                             \
  }                                                                     \
  static void test_##NAME(void)

#endif
