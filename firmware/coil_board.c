/* Reference firmware of a six-channel coil board: ATmega328P at 16 MHz (Arduino Uno, Nano).
 *
 * Host to board: duties in −1 … 1. Board to host: six measured currents, about 50 times a second
 * and after each command. Three things end in zero current without the host: 100 ms without a
 * good command, counted in an interrupt; a main loop that hangs, through the hardware watchdog;
 * and any reset, after which every output is off until the next good command.
 *
 * Coil   1    2    3    4    5    6
 * PWM    D9   D10  D6   D5   D11  D3    (sign and magnitude, 976 Hz)
 * sign   D2   D4   D7   D8   D12  D13   (high is positive)
 * sense  A0   A1   A2   A3   A4   A5    (half the supply is 0 A, the rails are ± FULL_SCALE_A)
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <util/atomic.h>

#include "packet.h"

#ifndef FULL_SCALE_A
#define FULL_SCALE_A 2.0f
#endif

enum {
    COILS = 6,
    FIRST_DUTY = 11,    /* index among the floats of a command */
    BAUD_500K = 3,      /* UBRR at 16 MHz and double speed */
    TICK_US = 1024,     /* timer 0 overflows every 64 · 256 cycles */
    DEAD_MAN = 100000L / TICK_US,
    STALL = 50000L / TICK_US,
    REPORT = 20000L / TICK_US,
};

static volatile uint8_t received[128], received_head;
static uint8_t received_tail;
static volatile uint8_t since_command, since_byte, since_report;

/* What carries a coil: its compare register, the bit that connects it to its pin, its sign. */
static const struct {
    volatile uint8_t *compare, *control, connect, *sign_port, sign;
} coil[COILS] = {
    {&OCR1AL, &TCCR1A, 1 << COM1A1, &PORTD, 1 << PD2},
    {&OCR1BL, &TCCR1A, 1 << COM1B1, &PORTD, 1 << PD4},
    {&OCR0A, &TCCR0A, 1 << COM0A1, &PORTD, 1 << PD7},
    {&OCR0B, &TCCR0A, 1 << COM0B1, &PORTB, 1 << PB0},
    {&OCR2A, &TCCR2A, 1 << COM2A1, &PORTB, 1 << PB4},
    {&OCR2B, &TCCR2A, 1 << COM2B1, &PORTB, 1 << PB5},
};
static uint16_t sense_at_zero[COILS];

/* At zero the pin is disconnected: a compare value of 0 would still pulse. */
static void drive(uint8_t index, int16_t steps)
{
    *coil[index].control &= (uint8_t)~coil[index].connect;
    if (steps == 0)
        return;
    if (steps > 0)
        *coil[index].sign_port |= coil[index].sign;
    else
        *coil[index].sign_port &= (uint8_t)~coil[index].sign;
    *coil[index].compare = (uint8_t)abs(steps);
    *coil[index].control |= coil[index].connect;
}

static void all_off(void)
{
    for (uint8_t index = 0; index < COILS; index++)
        drive(index, 0);
}

static uint8_t later(uint8_t ticks)
{
    return ticks < 255 ? ticks + 1 : ticks;
}

ISR(TIMER0_OVF_vect)
{
    since_byte = later(since_byte);
    since_report = later(since_report);
    since_command = later(since_command);
    if (since_command >= DEAD_MAN)
        all_off();
}

ISR(USART_RX_vect)
{
    uint8_t byte = UDR0, head = (received_head + 1) % sizeof received;
    if (head != received_tail) {
        received[received_head] = byte;
        received_head = head;
    }
}

static void send(const uint8_t *data, uint8_t length)
{
    while (length--) {
        loop_until_bit_is_set(UCSR0A, UDRE0);
        UDR0 = *data++;
    }
}

static uint16_t sense(uint8_t channel)
{
    ADMUX = (1 << REFS0) | channel;
    ADCSRA |= 1 << ADSC;
    loop_until_bit_is_clear(ADCSRA, ADSC);
    return ADC;
}

static void report(void)
{
    float currents[COILS];
    uint8_t packet[MEASUREMENT_BYTES + PACKET_EXTRA];
    for (uint8_t index = 0; index < COILS; index++)
        currents[index] = ((int16_t)sense(index) - (int16_t)sense_at_zero[index])
                          * (FULL_SCALE_A / 512);
    packet_encode((const uint8_t *)currents, packet);
    send(packet, sizeof packet);
    since_report = 0;
}

/* A command with a duty that is not within −1 … 1 (NaN is not) changes nothing. */
static bool obey(const uint8_t *payload)
{
    float values[COMMAND_BYTES / sizeof(float)];
    memcpy(values, payload, sizeof values);
    for (uint8_t index = 0; index < COILS; index++)
        if (!(values[FIRST_DUTY + index] >= -1.0f && values[FIRST_DUTY + index] <= 1.0f))
            return false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        since_command = 0;
        for (uint8_t index = 0; index < COILS; index++)
            drive(index, (int16_t)lround(values[FIRST_DUTY + index] * 255.0));
    }
    return true;
}

static void set_up(void)
{
    MCUSR = 0; /* or the watchdog that reset the board stays on at its shortest time */
    wdt_enable(WDTO_120MS);
    since_command = DEAD_MAN;
    DDRB = 0x3F;
    DDRD = 0xFC;
    TCCR0A = (1 << WGM01) | (1 << WGM00);
    TCCR0B = (1 << CS01) | (1 << CS00);
    TCCR1A = 1 << WGM10;
    TCCR1B = (1 << WGM12) | (1 << CS11) | (1 << CS10);
    TCCR2A = (1 << WGM21) | (1 << WGM20);
    TCCR2B = 1 << CS22;
    TIMSK0 = 1 << TOIE0;
    ADCSRA = (1 << ADEN) | (1 << ADPS2) | (1 << ADPS1) | (1 << ADPS0);
    for (uint8_t index = 0; index < COILS; index++)
        sense_at_zero[index] = sense(index);
    UCSR0A = 1 << U2X0;
    UBRR0 = BAUD_500K;
    UCSR0C = (1 << UCSZ01) | (1 << UCSZ00);
    UCSR0B = (1 << RXEN0) | (1 << TXEN0) | (1 << RXCIE0);
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();
}

int main(void)
{
    static struct packet_window window;
    uint8_t payload[COMMAND_BYTES];
    set_up();
    for (;;) {
        wdt_reset();
        if (window.count && since_byte > STALL)
            window.count = 0;
        while (received_tail != received_head) {
            uint8_t byte = received[received_tail];
            received_tail = (received_tail + 1) % sizeof received;
            since_byte = 0;
            if (packet_take(&window, byte, payload) && obey(payload))
                report();
        }
        if (since_report >= REPORT)
            report();
        cli(); /* a byte that comes here must still wake the sleep */
        if (received_tail == received_head) {
            sleep_enable();
            sei();
            sleep_cpu();
            sleep_disable();
        }
        sei();
    }
}
