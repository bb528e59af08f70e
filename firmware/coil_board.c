/* Reference firmware of a six-channel coil board: ATmega328P at 16 MHz (Arduino Uno, Nano).
 *
 * Host to board: duties in −1 … 1, or duties that turn: steady, cosine and sine part of each coil
 * (18 int16, full scale 32767) and the angular velocity [rad/s] (float32). What turns begins with
 * the packet at the cosine part and turns on until the next, which comes long before the dead-man
 * and sets it right: the host's is the clock. Board to host: six measured currents, about 50 times
 * a second and when the outputs have done what a command asked. Four things end in zero current without
 * the host: 100 ms without a good command, counted in an interrupt; a channel that carries current
 * it was not told to; a main loop that hangs, through the hardware watchdog; and any reset, after
 * which every output is off until the next good command.
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
#include <util/delay.h>

#include "packet.h"

#ifndef FULL_SCALE_A
#define FULL_SCALE_A 2.0f
#endif
#ifndef LIMIT_A /* a command beyond it is no command */
#define LIMIT_A FULL_SCALE_A
#endif
#ifndef SLEW_A_PER_S /* how fast a current grows; it is let go at once */
#define SLEW_A_PER_S 240.0f
#endif

enum {
    COILS = 6,
    FULL_STEPS = 255,   /* of an output */
    FIRST_DUTY = 11,    /* index among the floats of a command */
    BAUD_500K = 3,      /* UBRR at 16 MHz and double speed */
    TICK_US = 1024,     /* a PWM period: timer 0 overflows every 64 · 256 cycles */
    DEAD_MAN = 100000L / TICK_US,
    SETTLING = 100000L / TICK_US,
    STALL = 50000L / TICK_US,
    REPORT = 20000L / TICK_US,
    SHOWN = 2,          /* ticks after which a change is on the pins for a whole period */
    LET_GO_MS = 50,     /* what a coil's current takes to die after a reset */
    SENSE_FULL = 512,   /* counts from 0 A to a rail */
    OFF_CENTRE = SENSE_FULL / 10,
    FASTEST = 1000,     /* rad/s: a radian in a tick */
    WHOLE = 32767,      /* a duty of 1 among what turns */
    STRAY = SENSE_FULL / 4,
};
#define LIMIT_STEPS ((int16_t)(FULL_STEPS * LIMIT_A / FULL_SCALE_A + 0.5f))
#define GROWTH ((int16_t)(FULL_STEPS * SLEW_A_PER_S / FULL_SCALE_A * TICK_US * 1e-6f))
_Static_assert(LIMIT_STEPS >= 1 && LIMIT_STEPS <= FULL_STEPS,
               "LIMIT_A: 0 < LIMIT_A <= full scale");
_Static_assert(GROWTH >= 1 && GROWTH <= FULL_STEPS, "SLEW_A_PER_S: 1 to 255 steps in 1.024 ms");

static volatile uint8_t received[128], received_head;
static uint8_t received_tail;
static volatile uint8_t ticks, since_command, since_byte, since_report, since_change;
static volatile bool fault; /* until the next reset */

/* What carries a coil: its compare register and its sign. */
static const struct {
    volatile uint8_t *compare, *sign_port, sign;
} coil[COILS] = {
    {&OCR1AL, &PORTD, 1 << PD2}, {&OCR1BL, &PORTD, 1 << PD4}, {&OCR0A, &PORTD, 1 << PD7},
    {&OCR0B, &PORTB, 1 << PB0},  {&OCR2A, &PORTB, 1 << PB4},  {&OCR2B, &PORTB, 1 << PB5},
};
static int16_t target[COILS], output[COILS]; /* steps; shared with the interrupt */

/* Duties that turn: the vector (c, s) goes round by (step_c, step_s) a tick. */
static struct {
    bool on;
    uint8_t tick; /* up to which it has been turned */
    float c, s, step_c, step_s;
    int16_t parts[3][COILS]; /* steady, cosine, sine */
} turn;
static bool rested[COILS];
static uint16_t sense_at_zero[COILS];
static uint8_t last_true[COILS]; /* tick at which a channel last carried what it was told */

/* One tick of a coil on its way to `wanted` steps, called once in a PWM period.
 *
 * The timer takes a compare value over where its own period ends (double buffering), so a pin is
 * surely low only from the second tick after it was told so. Until then the coil rests at zero:
 * its sign never turns, and nothing begins anew, under the magnitude of before. */
static void move(uint8_t index, int16_t wanted)
{
    int16_t now = output[index];
    if (now == 0 && !rested[index]) {
        rested[index] = true;
        return;
    }
    if (wanted == now)
        return;
    if (now == 0 && wanted > 0)
        *coil[index].sign_port |= coil[index].sign;
    else if (now == 0)
        *coil[index].sign_port &= (uint8_t)~coil[index].sign;
    else if ((now > 0) != (wanted > 0))
        wanted = 0;
    if (wanted > 0 && wanted > now + GROWTH)
        wanted = now + GROWTH;
    if (wanted < 0 && wanted < now - GROWTH)
        wanted = now - GROWTH;
    if (wanted != 0)
        rested[index] = false;
    output[index] = wanted;
    *coil[index].compare = FULL_STEPS - (uint8_t)abs(wanted);
}

static uint8_t later(uint8_t count)
{
    return count < 255 ? count + 1 : count;
}

/* The one place that moves outputs. */
ISR(TIMER0_OVF_vect)
{
    ticks++;
    since_byte = later(since_byte);
    since_report = later(since_report);
    since_command = later(since_command);
    since_change = later(since_change);
    bool off = fault || since_command >= DEAD_MAN;
    for (uint8_t index = 0; index < COILS; index++) {
        int16_t wanted = off ? 0 : target[index];
        if (output[index] != wanted)
            since_change = 0;
        move(index, wanted);
    }
}

/* A byte with a wrong stop bit is left out: the packet is then too short to be one. */
ISR(USART_RX_vect)
{
    bool damaged = UCSR0A & (1 << FE0); /* before the byte is read: that clears it */
    uint8_t byte = UDR0, head = (received_head + 1) % sizeof received;
    if (!damaged && head != received_tail) {
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

/* Latches a fault where a channel has carried more than it was told, or the other way round, for
 * all of the settling time. Less than told harms nothing: an open coil is the host's to find. */
static void judge(uint8_t index, int16_t measured)
{
    int16_t told;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        told = output[index] * 2; /* 512 counts are 255 steps */
    }
    int16_t low = told < 0 ? told : 0, high = told > 0 ? told : 0;
    if (low - STRAY <= measured && measured <= high + STRAY)
        last_true[index] = ticks;
    else if ((uint8_t)(ticks - last_true[index]) >= SETTLING)
        fault = true;
}

static void report(void)
{
    float currents[COILS];
    uint8_t packet[MEASUREMENT_BYTES + PACKET_EXTRA];
    for (uint8_t index = 0; index < COILS; index++) {
        int16_t measured = (int16_t)sense(index) - (int16_t)sense_at_zero[index];
        judge(index, measured);
        currents[index] = measured * (FULL_SCALE_A / SENSE_FULL);
    }
    packet_encode((const uint8_t *)currents, packet);
    send(packet, sizeof packet);
    since_report = 0;
}

static void aim(const int16_t wanted[COILS])
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (memcmp(target, wanted, sizeof target))
            since_change = 0;
        memcpy(target, wanted, sizeof target);
    }
}

/* A command with a duty that is not within −1 … 1 (NaN is not), or beyond the limit, changes
 * nothing and keeps nothing on. */
static bool obey(const uint8_t *payload)
{
    float values[COMMAND_BYTES / sizeof(float)];
    int16_t wanted[COILS];
    memcpy(values, payload, sizeof values);
    for (uint8_t index = 0; index < COILS; index++) {
        float duty = values[FIRST_DUTY + index];
        if (!(duty >= -1.0f && duty <= 1.0f))
            return false;
        wanted[index] = (int16_t)lround(duty * FULL_STEPS);
        if (abs(wanted[index]) > LIMIT_STEPS)
            return false;
    }
    turn.on = false;
    aim(wanted);
    since_command = 0;
    return true;
}

/* The targets of this tick, a vector further; each change waits for the interrupt. */
static void turn_on(void)
{
    int16_t wanted[COILS];
    for (; turn.tick != ticks; turn.tick++) {
        float c = turn.c * turn.step_c - turn.s * turn.step_s;
        turn.s = turn.s * turn.step_c + turn.c * turn.step_s;
        turn.c = c;
    }
    for (uint8_t index = 0; index < COILS; index++)
        wanted[index] = (int16_t)lround((turn.parts[0][index] + turn.parts[1][index] * turn.c
                                         + turn.parts[2][index] * turn.s)
                                        * ((float)FULL_STEPS / WHOLE));
    aim(wanted);
}

/* As `obey`, of what turns. The largest duty on the way counts against the limit. */
static bool obey_turn(const uint8_t *payload)
{
    int16_t parts[3][COILS];
    float rate;
    memcpy(parts, payload, sizeof parts);
    memcpy(&rate, payload + sizeof parts, sizeof rate);
    if (!(rate >= -FASTEST && rate <= FASTEST))
        return false;
    for (uint8_t index = 0; index < COILS; index++) {
        float largest = fabsf(parts[0][index]) + hypotf(parts[1][index], parts[2][index]);
        if (lround(largest * ((float)FULL_STEPS / WHOLE)) > LIMIT_STEPS)
            return false;
    }
    memcpy(turn.parts, parts, sizeof parts);
    turn.on = true;
    turn.tick = ticks;
    turn.c = 1.0f;
    turn.s = 0.0f;
    turn.step_c = cosf(rate * (TICK_US * 1e-6f));
    turn.step_s = sinf(rate * (TICK_US * 1e-6f));
    turn_on();
    since_command = 0;
    return true;
}

/* The outputs are inverted, set at the match and cleared at the end: a compare value of 255 is
 * then low without a spike, which 0 is not the other way round. It is written before the timers
 * run, when nothing is buffered, so that no pin is ever high before a command. */
static void start_outputs(void)
{
    DDRB = 0x3F; /* low, as the ports are after a reset */
    DDRD = 0xFC;
    for (uint8_t index = 0; index < COILS; index++)
        *coil[index].compare = FULL_STEPS;
    TCCR0A = (1 << COM0A1) | (1 << COM0A0) | (1 << COM0B1) | (1 << COM0B0) | (1 << WGM01)
             | (1 << WGM00);
    TCCR0B = (1 << CS01) | (1 << CS00);
    TCCR1A = (1 << COM1A1) | (1 << COM1A0) | (1 << COM1B1) | (1 << COM1B0) | (1 << WGM10);
    TCCR1B = (1 << WGM12) | (1 << CS11) | (1 << CS10);
    TCCR2A = (1 << COM2A1) | (1 << COM2A0) | (1 << COM2B1) | (1 << COM2B0) | (1 << WGM21)
             | (1 << WGM20);
    TCCR2B = 1 << CS22;
    TIMSK0 = 1 << TOIE0;
}

/* Takes what each channel measures at zero. Far from half the supply is no sensor's zero: a line
 * has come off, or current flows that nobody asked for. */
static void start_sensing(void)
{
    ADCSRA = (1 << ADEN) | (1 << ADPS2) | (1 << ADPS1) | (1 << ADPS0);
    wdt_reset();
    _delay_ms(LET_GO_MS);
    for (uint8_t index = 0; index < COILS; index++) {
        sense_at_zero[index] = sense(index);
        if (abs((int16_t)sense_at_zero[index] - SENSE_FULL) > OFF_CENTRE)
            fault = true;
    }
}

static void set_up(void)
{
    MCUSR = 0; /* or the watchdog that reset the board stays on at its shortest time */
    wdt_enable(WDTO_120MS);
    since_command = DEAD_MAN;
    start_outputs();
    start_sensing();
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
    bool answer_due = false;
    set_up();
    for (;;) {
        wdt_reset();
        if (window.count && since_byte > STALL)
            window.count = 0;
        while (received_tail != received_head) {
            uint8_t byte = received[received_tail];
            received_tail = (received_tail + 1) % sizeof received;
            since_byte = 0;
            enum packet_kind kind = packet_take(&window, byte, payload);
            if ((kind == COMMAND_PACKET && obey(payload))
                || (kind == TURN_PACKET && obey_turn(payload)))
                answer_due = true;
        }
        if (turn.on && turn.tick != ticks)
            turn_on();
        if (since_report >= REPORT || (answer_due && since_change >= SHOWN)) {
            report();
            answer_due = false;
        }
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
