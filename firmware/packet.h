/* The SerialTransfer packet: 7E, id, overhead, length, payload, CRC-8, 81. See packet.c. */
#ifndef PACKET_H
#define PACKET_H

#include <stdbool.h>
#include <stdint.h>

#define COMMAND_BYTES 68     /* from the host: 17 float32, or what turns (coil_board.c) */
#define MEASUREMENT_BYTES 24 /* 6 float32 to the host */
#define PACKET_EXTRA 6       /* bytes around a payload */

/* The bytes that may yet become a command. All zero is empty. */
struct packet_window {
    uint8_t bytes[COMMAND_BYTES + PACKET_EXTRA];
    uint8_t count;
};

enum packet_kind { NO_PACKET, COMMAND_PACKET, TURN_PACKET };

/* Takes one byte. The kind of the good packet that it completed, whose payload is then in
 * `payload`. */
enum packet_kind packet_take(struct packet_window *window, uint8_t byte,
                             uint8_t payload[COMMAND_BYTES]);

/* Writes the packet of a measurement. */
void packet_encode(const uint8_t payload[MEASUREMENT_BYTES],
                   uint8_t packet[MEASUREMENT_BYTES + PACKET_EXTRA]);

#endif
