// The hash BLAKE2s of RFC 7693, with or without a key.
#pragma once

#include <stddef.h>
#include <stdint.h>

#define BLAKE2S_MAX_DIGEST 32

// `digest_size` is 1 to 32, `key_size` 0 to 32.
void blake2s(uint8_t* digest, size_t digest_size, const uint8_t* key, size_t key_size, const uint8_t* data,
             size_t size);
