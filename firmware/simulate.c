/* The firmware on a simulated ATmega328P: its UART on a pseudo-terminal, its coils in a log.
 *
 *     simulate coil_board.elf [--no-pull-downs]
 *
 * Prints the terminal's name, then a line of JSON for each change at the pins: the time of this
 * machine and of the simulated one, how often the board has restarted, how many of the twelve
 * PWM and sign pins float, and the duties of the six bridges over the PWM period that ended. A
 * pin that floats is low, because the wiring pulls it down; without pull-downs it counts as high.
 *
 * simavr gives a compare value to the output at once. The output unit is therefore modelled here,
 * after the ATmega328P data sheet (15.7.3, 16.9.3 and 18.7.3, fast PWM): a compare value is taken
 * over at BOTTOM; the output is set or cleared there and at the match, and keeps its state while
 * no pin is connected to it; a match at TOP is none (notes to tables 15-3, 15-6, 16-2, 18-3 and
 * 18-6).
 *
 * Lines on its input, each logged too, change the world around the board: `reset`;
 * `carry CHANNEL PART`, a channel carries that part of full scale more than it is told; `damage`,
 * the next byte from the host comes with a wrong stop bit; `hang`, the program stops in a loop
 * with interrupts off.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_extint.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

enum {
    COILS = 6,
    TIMERS = 3,
    SLICE_CYCLES = 800,
    STEP_CYCLES = 64, /* of a timer: the prescaler */
    TOP = 255,
    CLEAR_AT_MATCH = 2,
    SET_AT_MATCH = 3,
    MID_SUPPLY_MV = 2500,
    LOOP_AT = 0x7FF0, /* in the flash, behind the program */
    LOOP = 0xCFFF,    /* rjmp to itself */
};

/* Data-space addresses of the ATmega328P: data sheet, register summary. The direction of a port
 * is right before the port. */
static const int clock_select[TIMERS] = {0x45, 0x81, 0xB1};
static const struct {
    int timer, compare, control, shift, pwm_port, pwm, sign_port, sign;
} coil[COILS] = {
    {1, 0x88, 0x80, 6, 0x25, 1 << 1, 0x2B, 1 << 2}, {1, 0x8A, 0x80, 4, 0x25, 1 << 2, 0x2B, 1 << 4},
    {0, 0x47, 0x44, 6, 0x2B, 1 << 6, 0x2B, 1 << 7}, {0, 0x48, 0x44, 4, 0x2B, 1 << 5, 0x25, 1 << 0},
    {2, 0xB3, 0xB0, 6, 0x25, 1 << 3, 0x25, 1 << 4}, {2, 0xB4, 0xB0, 4, 0x2B, 1 << 3, 0x25, 1 << 5},
};

/* The output unit of each coil: the compare value in force, its state, and what the bridge saw
 * in this period: cycles forward less cycles backward. */
static struct {
    int compare;
    bool high;
    int64_t driven;
    avr_cycle_count_t bottom;
} unit[COILS];
static avr_timer_t *timer[TIMERS];
static avr_cycle_count_t seen;
static double duties[COILS], strays[COILS];

static volatile sig_atomic_t stopping;
static bool pulled_down = true, damage;
static int terminal, paused, restarts = -1, told;
static void (*reset_chip)(avr_t *);

static void on_signal(int number)
{
    (void)number;
    stopping = 1;
}

static void on_output(struct avr_irq_t *irq, uint32_t value, void *param)
{
    uint8_t byte = (uint8_t)value;
    (void)irq, (void)param;
    if (write(terminal, &byte, 1) != 1)
        return; /* nobody reads: lost, as on a wire */
}

static void on_room(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)value;
    paused = param != NULL;
}

static void on_message(avr_t *avr, const int level, const char *format, va_list values)
{
    (void)avr;
    if (level <= LOG_ERROR)
        vfprintf(stderr, format, values);
}

/* Every reset comes here, the watchdog's too. */
static void on_reset(avr_t *avr)
{
    reset_chip(avr);
    memset(unit, 0, sizeof unit);
    restarts++;
}

static int open_terminal(void)
{
    terminal = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (terminal < 0 || grantpt(terminal) || unlockpt(terminal))
        return -1;
    int kept = open(ptsname(terminal), O_RDWR | O_NOCTTY);
    struct termios raw;
    if (kept < 0 || tcgetattr(kept, &raw))
        return -1;
    cfmakeraw(&raw);
    return tcsetattr(kept, TCSANOW, &raw);
}

static bool floats(avr_t *avr, int port, int bit)
{
    return !(avr->data[port - 1] & bit);
}

static bool level(avr_t *avr, int port, int bit, bool driven)
{
    return floats(avr, port, bit) ? !pulled_down : driven;
}

static int mode(avr_t *avr, int i)
{
    return avr->data[coil[i].control] >> coil[i].shift & 3;
}

/* What the bridge does now: forward, nothing or backward. */
static int bridge(avr_t *avr, int i)
{
    bool port = avr->data[coil[i].pwm_port] & coil[i].pwm;
    bool sign = avr->data[coil[i].sign_port] & coil[i].sign;
    if (!level(avr, coil[i].pwm_port, coil[i].pwm, mode(avr, i) ? unit[i].high : port))
        return 0;
    return level(avr, coil[i].sign_port, coil[i].sign, sign) ? 1 : -1;
}

/* Brings a coil from one cycle of a PWM period to another. */
static void advance(avr_t *avr, int i, avr_cycle_count_t from, avr_cycle_count_t to)
{
    avr_cycle_count_t match = unit[i].bottom + STEP_CYCLES * (unit[i].compare + 1);
    if (mode(avr, i) && unit[i].compare != TOP && from < match && match <= to) {
        unit[i].driven += bridge(avr, i) * (int64_t)(match - from);
        unit[i].high = mode(avr, i) == SET_AT_MATCH;
        from = match;
    }
    unit[i].driven += bridge(avr, i) * (int64_t)(to - from);
}

/* BOTTOM of a coil's timer: a period has ended, the next compare value is taken over. */
static void begin_period(avr_t *avr, int i, avr_cycle_count_t now)
{
    duties[i] = (double)unit[i].driven / (now - unit[i].bottom);
    unit[i].driven = 0;
    unit[i].bottom = now;
    unit[i].compare = avr->data[coil[i].compare];
    if (mode(avr, i))
        unit[i].high = mode(avr, i) == CLEAR_AT_MATCH;
}

/* Follows the pins up to now. A timer without a clock buffers nothing. */
static void follow(avr_t *avr)
{
    for (int i = 0; i < COILS; i++) {
        int t = coil[i].timer;
        avr_cycle_count_t next = timer[t]->tov_base;
        if (!(avr->data[clock_select[t]] & 7)) {
            unit[i].compare = avr->data[coil[i].compare];
            duties[i] = bridge(avr, i);
            continue;
        }
        if (next != unit[i].bottom) {
            advance(avr, i, seen, next);
            begin_period(avr, i, next);
        }
        advance(avr, i, seen > next ? seen : next, avr->cycle);
    }
    seen = avr->cycle;
}

static void log_change(avr_t *avr)
{
    static double logged[COILS];
    static int floated = -1, before = -1;
    int floating = 0;
    for (int i = 0; i < COILS; i++)
        floating += floats(avr, coil[i].pwm_port, coil[i].pwm)
                    + floats(avr, coil[i].sign_port, coil[i].sign);
    if (before == restarts + told && floated == floating && !memcmp(logged, duties, sizeof logged))
        return;
    before = restarts + told, floated = floating;
    memcpy(logged, duties, sizeof logged);
    struct timespec clock;
    clock_gettime(CLOCK_MONOTONIC, &clock);
    printf("{\"t_monotonic_s\": %.6f, \"t_device_s\": %.6f, \"restarts\": %d, \"floating\": %d, "
           "\"duties\": [", (double)clock.tv_sec + clock.tv_nsec * 1e-9,
           (double)avr->cycle / avr->frequency, restarts, floating);
    for (int i = 0; i < COILS; i++)
        printf("%s%.6f", i ? ", " : "", duties[i]);
    printf("]}\n");
    fflush(stdout);
}

/* Gives each sense input what its channel carries: the coils follow at once. */
static void carry(avr_t *avr)
{
    for (int i = 0; i < COILS; i++) {
        double part = duties[i] + strays[i];
        part = part > 1 ? 1 : part < -1 ? -1 : part;
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + i),
                      (uint32_t)(MID_SUPPLY_MV * (1 + part)));
    }
}

static void hang(avr_t *avr)
{
    avr->flash[LOOP_AT] = LOOP & 0xFF;
    avr->flash[LOOP_AT + 1] = LOOP >> 8;
    avr->pc = LOOP_AT;
    avr->sreg[S_I] = 0;
    avr->state = cpu_Running;
}

static void obey(avr_t *avr, const char *line)
{
    int channel;
    double part;
    if (sscanf(line, "carry %d %lf", &channel, &part) == 2 && channel >= 1 && channel <= COILS)
        strays[channel - 1] = part;
    else if (!strcmp(line, "reset\n"))
        avr_reset(avr);
    else if (!strcmp(line, "damage\n"))
        damage = true;
    else if (!strcmp(line, "hang\n"))
        hang(avr);
    else
        fprintf(stderr, "not understood: %s", line);
    told++;
}

static void take_lines(avr_t *avr)
{
    static bool ended;
    struct pollfd input = {.fd = STDIN_FILENO, .events = POLLIN};
    char line[80];
    while (!ended && poll(&input, 1, 0) > 0) {
        if (fgets(line, sizeof line, stdin))
            obey(avr, line);
        else
            ended = true;
    }
}

/* Takes bytes from the host, and before them the lines that were written before them. */
static void feed(avr_t *avr)
{
    static uint8_t bytes[64];
    static ssize_t count, next;
    if (next >= count) {
        count = read(terminal, bytes, sizeof bytes);
        next = 0;
    }
    take_lines(avr);
    avr_irq_t *input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    while (!paused && next < count) {
        avr_raise_irq(input, bytes[next++] | (damage ? UART_INPUT_FE : 0));
        damage = false;
    }
}

static avr_t *power_up(const char *path)
{
    elf_firmware_t firmware = {0};
    avr_global_logger_set(on_message);
    if (elf_read_firmware(path, &firmware))
        return NULL;
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    if (!avr)
        return NULL;
    reset_chip = avr->reset;
    avr->reset = on_reset;
    if (avr_init(avr))
        return NULL;
    avr->frequency = 16000000;
    avr->vcc = avr->avcc = avr->aref = 2 * MID_SUPPLY_MV;
    avr_load_firmware(avr, &firmware);
    uint32_t quiet = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &quiet);
    avr_irq_t *uart = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), 0);
    avr_irq_register_notify(uart + UART_IRQ_OUTPUT, on_output, NULL);
    avr_irq_register_notify(uart + UART_IRQ_OUT_XON, on_room, NULL);
    avr_irq_register_notify(uart + UART_IRQ_OUT_XOFF, on_room, avr);
    for (avr_io_t *part = avr->io_port; part; part = part->next)
        if (!strcmp(part->kind, "timer"))
            timer[((avr_timer_t *)part)->name - '0'] = (avr_timer_t *)part;
    return avr;
}

/* Runs for a moment, or until the board restarts; false where it has crashed. */
static bool run_slice(avr_t *avr)
{
    avr_cycle_count_t end = avr->cycle + SLICE_CYCLES;
    int started = restarts;
    for (uint8_t i = 0; i < 2; i++)
        avr_extint_set_strict_lvl_trig(avr, i, 0); /* it would look at low pins in every cycle */
    while (avr->cycle < end && restarts == started) {
        if (avr_run(avr) >= cpu_Done)
            return false;
        follow(avr);
    }
    return true;
}

int main(int count, char **arguments)
{
    pulled_down = count != 3 || strcmp(arguments[2], "--no-pull-downs");
    avr_t *avr = (count == 2 || !pulled_down) && !open_terminal() ? power_up(arguments[1]) : NULL;
    if (!avr) {
        fprintf(stderr, "usage: simulate FIRMWARE.elf [--no-pull-downs]\n");
        return 2;
    }
    signal(SIGTERM, on_signal);
    signal(SIGINT, on_signal);
    setvbuf(stdin, NULL, _IONBF, 0); /* or a line could wait unseen behind another */
    printf("%s\n", ptsname(terminal));
    while (!stopping) {
        follow(avr);
        log_change(avr);
        carry(avr);
        feed(avr);
        if (!run_slice(avr))
            return 1;
    }
    return 0;
}
