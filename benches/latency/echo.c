/* The lower bound of a UDP round trip on this machine: returns every datagram to its sender.
   cc -O2 echo.c -o echo && ./echo        prints the port on which it listens, on loopback. */
#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdio.h>
#include <sys/socket.h>

int main(void) {
    int sock = socket(AF_INET, SOCK_DGRAM, 0);
    struct sockaddr_in self = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t length = sizeof self;
    if (sock < 0 || bind(sock, (struct sockaddr *)&self, sizeof self) < 0 ||
        getsockname(sock, (struct sockaddr *)&self, &length) < 0) {
        perror("echo");
        return 1;
    }
    printf("%d\n", ntohs(self.sin_port));
    fflush(stdout);
    for (;;) {
        char datagram[2048];
        struct sockaddr_in peer;
        socklen_t peer_length = sizeof peer;
        ssize_t count = recvfrom(sock, datagram, sizeof datagram, 0, (struct sockaddr *)&peer, &peer_length);
        if (count > 0) sendto(sock, datagram, (size_t)count, 0, (struct sockaddr *)&peer, peer_length);
    }
}
