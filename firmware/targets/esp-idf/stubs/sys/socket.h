// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

#include <stddef.h>
#include <sys/types.h>

#define AF_INET 2
#define SOCK_DGRAM 2
#define MSG_DONTWAIT 8

typedef unsigned int socklen_t;
struct sockaddr {
  unsigned char sa_len, sa_family;
  char sa_data[14];
};

int socket(int domain, int type, int protocol);
int connect(int socket, const struct sockaddr* address, socklen_t size);
ssize_t send(int socket, const void* data, size_t size, int flags);
ssize_t recv(int socket, void* data, size_t size, int flags);
