#include <string.h>

#include "blake2s.h"
#include "check.h"

static void check_hex(const uint8_t* digest, size_t size, const char* expected) {
  char hex[2 * BLAKE2S_MAX_DIGEST + 1];
  for (size_t i = 0; i < size; ++i) snprintf(hex + 2 * i, 3, "%02x", digest[i]);
  if (strcmp(hex, expected) == 0) return;
  ++check_failures;
  printf("the digest is %s, not %s\n", hex, expected);
}

// RFC 7693, appendix B.
static void abc_has_the_digest_of_the_standard(void) {
  uint8_t digest[32];
  blake2s(digest, 32, NULL, 0, (const uint8_t*)"abc", 3);
  check_hex(digest, 32, "508c5e8c327c14e2e1a72ba34eeb452f37458b209ed63a294d999b4c86675982");
}

// RFC 7693, appendix E: deterministic input,
static void fill(uint8_t* bytes, size_t size, uint32_t seed) {
  uint32_t a = 0xDEAD4BAD * seed, b = 1;
  for (size_t i = 0; i < size; ++i) {
    const uint32_t next = a + b;
    a = b;
    b = next;
    bytes[i] = (uint8_t)(next >> 24);
  }
}

// and the digest of the digests of all sizes, with and without a key.
static void the_self_test_of_the_standard_passes(void) {
  static const size_t digest_sizes[] = {16, 20, 28, 32}, sizes[] = {0, 3, 64, 65, 255, 1024};
  uint8_t input[1024], key[32], all[2 * 6 * (16 + 20 + 28 + 32)];
  size_t end = 0;
  for (unsigned i = 0; i < 4; ++i) {
    for (unsigned j = 0; j < 6; ++j) {
      fill(input, sizes[j], (uint32_t)sizes[j]);
      blake2s(all + end, digest_sizes[i], NULL, 0, input, sizes[j]);
      end += digest_sizes[i];
      fill(key, digest_sizes[i], (uint32_t)digest_sizes[i]);
      blake2s(all + end, digest_sizes[i], key, digest_sizes[i], input, sizes[j]);
      end += digest_sizes[i];
    }
  }
  CHECK_EQUAL(end, sizeof all);
  uint8_t digest[32];
  blake2s(digest, 32, NULL, 0, all, sizeof all);
  check_hex(digest, 32, "6a411f08ce25adcdfb02aba641451cec53c598b24f4fc787fbdc88797f4c1dfe");
}

// Python's hashlib.blake2s(data, digest_size=, key=): data[i] = i i + 11 i + 5, key[i] = 7 i + 3, modulo 256.
static void digests_are_those_of_another_implementation(void) {
  static const struct {
    size_t size, key_size, digest_size;
    const char* digest;
  } known[] = {
      {0, 0, 32, "69217a3079908094e11121d042354a7c1f55b6482ca1a51e1b250dfd1ed0eef9"},
      {0, 32, 16, "99e8b26f21ad249a22849abf7c73666e"},
      {1, 32, 16, "3eeb29af803359fe0efbe0e10bb0caac"},
      {63, 32, 16, "75164490626f8ffa0cbc9e3bd386aa77"},
      {64, 32, 16, "e16959bb8ed8e44033febb1963beeb71"},
      {65, 32, 16, "02308b0b9fe9377f14f664529bc0a147"},
      {127, 32, 16, "c7245849510eeeecf2b7fdf7028ea75d"},
      {128, 32, 16, "c08868465f1ca11b54814ca0bf69baf9"},
      {129, 32, 16, "28324a16103ebdd2c0295337488b00ca"},
      {808, 32, 16, "001b673003918195801b8fe7738c17c0"},
      {64, 0, 32, "095f11da253e6d7def36409cecf642ab004b0bc80746534699567fdcbbcd6238"},
      {129, 1, 1, "ab"},
      {1000, 17, 20, "0ec4c22d6ea1e07aec52b4028f7df71736fc4324"},
  };
  for (unsigned k = 0; k < sizeof known / sizeof known[0]; ++k) {
    uint8_t data[1000], key[32], digest[32];
    for (unsigned i = 0; i < sizeof data; ++i) data[i] = (uint8_t)(i * i + 11 * i + 5);
    for (unsigned i = 0; i < sizeof key; ++i) key[i] = (uint8_t)(7 * i + 3);
    blake2s(digest, known[k].digest_size, key, known[k].key_size, data, known[k].size);
    check_hex(digest, known[k].digest_size, known[k].digest);
  }
}

int main(void) {
  abc_has_the_digest_of_the_standard();
  the_self_test_of_the_standard_passes();
  digests_are_those_of_another_implementation();
  return check_verdict();
}
