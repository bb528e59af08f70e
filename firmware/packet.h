/* The SerialTransfer packet: 7E, id, overhead, length, payload, CRC-8, 81. See packet.c. */
#ifndef PACKET_H
#define PACKET_H

#include <stdbool.h>
#include <stdint.h>

#define COMMAND_BYTES 68     /* 17 float32 from the host */
#define MEASUREMENT_BYTES 24 /* 6 float32 to the host */
#define PACKET_EXTRA 6       /* bytes around a payload */

/* The bytes that may yet become a command. All zero is empty. */
struct packet_window {
    uint8_t bytes[COMMAND_BYTES + PACKET_EXTRA];
    uint8_t count;
};

/* Takes one byte. True when it completed a good command, whose payload is then in `payload`. */
bool packet_take(struct packet_window *window, uint8_t byte, uint8_t payload[COMMAND_BYTES]);

/* Writes the packet of a measurement. */
void packet_encode(const uint8_t payload[MEASUREMENT_BYTES],
                   uint8_t packet[MEASUREMENT_BYTES + PACKET_EXTRA]);

#endif
