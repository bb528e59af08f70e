/* SerialTransfer on the board's side.
 *
 * Only 7E is stuffed: `overhead` is the index of the first one in the payload (FF: none), each is
 * replaced by the distance to the next, the last by 0. The CRC, polynomial 0x9B and initial value
 * 0, covers the stuffed payload alone, so the header is checked byte by byte as well.
 */
#include "packet.h"

#include <string.h>

enum { START = 0x7E, END = 0x81, ID = 0x00, TURN_ID = 0x01, NOTHING_STUFFED = 0xFF, HEADER = 4 };

static uint8_t crc8(const uint8_t *data, uint8_t length)
{
    uint8_t crc = 0;
    while (length--) {
        crc ^= *data++;
        for (uint8_t bit = 0; bit < 8; bit++)
            crc = (uint8_t)(crc & 0x80 ? crc << 1 ^ 0x9B : crc << 1);
    }
    return crc;
}

/* Puts the 7Es back; false where the chain leaves the payload. */
static bool unstuff(uint8_t *payload, uint8_t length, uint8_t overhead)
{
    uint8_t index = overhead;
    while (index != NOTHING_STUFFED) {
        if (index >= length)
            return false;
        uint8_t distance = payload[index];
        payload[index] = START;
        if (distance == 0)
            return true;
        if (distance >= length - index)
            return false;
        index += distance;
    }
    return true;
}

static uint8_t stuff(uint8_t *payload, uint8_t length)
{
    uint8_t following = NOTHING_STUFFED;
    for (uint8_t index = length; index-- > 0;)
        if (payload[index] == START) {
            payload[index] = following == NOTHING_STUFFED ? 0 : following - index;
            following = index;
        }
    return following;
}

static bool may_start(const struct packet_window *window)
{
    const uint8_t *b = window->bytes, n = window->count;
    return (n < 1 || b[0] == START) && (n < 2 || b[1] == ID || b[1] == TURN_ID)
        && (n < 3 || b[2] < COMMAND_BYTES || b[2] == NOTHING_STUFFED)
        && (n < 4 || b[3] == COMMAND_BYTES);
}

static bool complete(const struct packet_window *window, uint8_t *payload)
{
    const uint8_t *stuffed = window->bytes + HEADER;
    if (stuffed[COMMAND_BYTES] != crc8(stuffed, COMMAND_BYTES)
        || stuffed[COMMAND_BYTES + 1] != END)
        return false;
    if (memchr(stuffed, START, COMMAND_BYTES))
        return false; /* no distance in so short a payload is 7E */
    memcpy(payload, stuffed, COMMAND_BYTES);
    return unstuff(payload, COMMAND_BYTES, window->bytes[2]);
}

enum packet_kind packet_take(struct packet_window *window, uint8_t byte,
                             uint8_t payload[COMMAND_BYTES])
{
    enum packet_kind good = NO_PACKET;
    window->bytes[window->count++] = byte;
    if (window->count == sizeof window->bytes && complete(window, payload)) {
        good = window->bytes[1] == TURN_ID ? TURN_PACKET : COMMAND_PACKET;
        window->count = 0;
    }
    /* After damage, look for the next start behind the last one believed. */
    while (window->count == sizeof window->bytes || !may_start(window))
        memmove(window->bytes, window->bytes + 1, --window->count);
    return good;
}

void packet_encode(const uint8_t payload[MEASUREMENT_BYTES],
                   uint8_t packet[MEASUREMENT_BYTES + PACKET_EXTRA])
{
    uint8_t *stuffed = packet + HEADER;
    memcpy(stuffed, payload, MEASUREMENT_BYTES);
    packet[0] = START;
    packet[1] = ID;
    packet[2] = stuff(stuffed, MEASUREMENT_BYTES);
    packet[3] = MEASUREMENT_BYTES;
    stuffed[MEASUREMENT_BYTES] = crc8(stuffed, MEASUREMENT_BYTES);
    stuffed[MEASUREMENT_BYTES + 1] = END;
}
