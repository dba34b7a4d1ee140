#include "blake2s.h"

#include <stdbool.h>
#include <string.h>

#define BLOCK_SIZE 64
#define ROUNDS 10

// RFC 7693, 2.6: the first 32 bits of the fractional parts of the square roots of the first eight primes.
static const uint32_t initial[8] = {0x6A09E667, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A,
                                    0x510E527F, 0x9B05688C, 0x1F83D9AB, 0x5BE0CD19};

// RFC 7693, 2.7: which words of the block each round mixes in, in which order.
static const uint8_t schedule[ROUNDS][16] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15},
    {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
    {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4},
    {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
    {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13},
    {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
    {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11},
    {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
    {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5},
    {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0},
};

// RFC 7693, 3.2: the working vector as a 4 x 4 matrix; its columns are mixed, then its diagonals.
static const uint8_t lanes[8][4] = {{0, 4, 8, 12},  {1, 5, 9, 13},  {2, 6, 10, 14}, {3, 7, 11, 15},
                                    {0, 5, 10, 15}, {1, 6, 11, 12}, {2, 7, 8, 13},  {3, 4, 9, 14}};

static uint32_t load_word(const uint8_t* at) {
  return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static uint32_t rotate_right(uint32_t word, unsigned bits) { return word >> bits | word << (32 - bits); }

// RFC 7693, 3.1: G.
static void mix(uint32_t v[16], const uint8_t lane[4], uint32_t x, uint32_t y) {
  uint32_t a = v[lane[0]], b = v[lane[1]], c = v[lane[2]], d = v[lane[3]];
  a += b + x;
  d = rotate_right(d ^ a, 16);
  c += d;
  b = rotate_right(b ^ c, 12);
  a += b + y;
  d = rotate_right(d ^ a, 8);
  c += d;
  b = rotate_right(b ^ c, 7);
  v[lane[0]] = a, v[lane[1]] = b, v[lane[2]] = c, v[lane[3]] = d;
}

// RFC 7693, 3.2: F. `counted` bytes have gone in, those of this block among them.
static void compress(uint32_t state[8], const uint8_t block[BLOCK_SIZE], uint64_t counted, bool last) {
  uint32_t words[16], v[16];
  for (size_t i = 0; i < 16; ++i) words[i] = load_word(block + 4 * i);
  for (unsigned i = 0; i < 8; ++i) v[i] = state[i], v[i + 8] = initial[i];
  v[12] ^= (uint32_t)counted;
  v[13] ^= (uint32_t)(counted >> 32);
  if (last) v[14] = ~v[14];
  for (unsigned round = 0; round < ROUNDS; ++round) {
    const uint8_t* const order = schedule[round];
    for (size_t i = 0; i < 8; ++i) mix(v, lanes[i], words[order[2 * i]], words[order[2 * i + 1]]);
  }
  for (unsigned i = 0; i < 8; ++i) state[i] ^= v[i] ^ v[i + 8];
}

void blake2s(uint8_t* digest, size_t digest_size, const uint8_t* key, size_t key_size, const uint8_t* data,
             size_t size) {
  uint32_t state[8];
  memcpy(state, initial, sizeof state);
  state[0] ^= 0x01010000U ^ (uint32_t)key_size << 8 ^ (uint32_t)digest_size;

  uint8_t block[BLOCK_SIZE] = {0};
  uint64_t counted = 0;
  // A key goes in first, as a block of its own (RFC 7693, 3.3).
  if (key_size > 0) {
    memcpy(block, key, key_size);
    counted = BLOCK_SIZE;
    compress(state, block, counted, size == 0);
  }
  while (size > BLOCK_SIZE) {
    counted += BLOCK_SIZE;
    compress(state, data, counted, false);
    data += BLOCK_SIZE;
    size -= BLOCK_SIZE;
  }
  // The last block is filled up with zeros; it is there without any data too, unless the key was the last.
  if (size > 0 || key_size == 0) {
    memset(block, 0, sizeof block);
    if (size > 0) memcpy(block, data, size);
    compress(state, block, counted + size, true);
  }
  for (size_t i = 0; i < digest_size; ++i) digest[i] = (uint8_t)(state[i / 4] >> 8 * (i % 4));
}
