/* The firmware on a simulated ATmega328P: its UART on a pseudo-terminal, its coils in a log.
 *
 *     simulate coil_board.elf
 *
 * Prints the terminal's name, then a line of JSON for each change of the outputs: the time of
 * this machine and of the simulated one, the duties, and how often the board has restarted.
 * The coils follow at once, and the sense inputs with them. SIGUSR1 resets the board.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

enum { COILS = 6, SLICE_CYCLES = 800, MID_SUPPLY_MV = 2500 };

/* Data-space addresses of the ATmega328P: data sheet, register summary. */
static const struct {
    int compare, control, connect, port, sign;
} coil[COILS] = {
    {0x88, 0x80, 0x80, 0x2B, 1 << 2}, {0x8A, 0x80, 0x20, 0x2B, 1 << 4},
    {0x47, 0x44, 0x80, 0x2B, 1 << 7}, {0x48, 0x44, 0x20, 0x25, 1 << 0},
    {0xB3, 0xB0, 0x80, 0x25, 1 << 4}, {0xB4, 0xB0, 0x20, 0x25, 1 << 5},
};

static volatile sig_atomic_t stopping, resetting;
static int terminal, paused, restarts;

static void on_signal(int number)
{
    if (number == SIGUSR1)
        resetting = 1;
    else
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

static void feed(avr_t *avr)
{
    avr_irq_t *input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    uint8_t byte;
    while (!paused && read(terminal, &byte, 1) == 1)
        avr_raise_irq(input, byte);
}

static void observe(avr_t *avr)
{
    static double duties[COILS];
    static int started;
    double now[COILS];
    for (int i = 0; i < COILS; i++) {
        int connected = avr->data[coil[i].control] & coil[i].connect;
        int positive = avr->data[coil[i].port] & coil[i].sign;
        now[i] = (connected ? avr->data[coil[i].compare] / 255.0 : 0.0) * (positive ? 1 : -1);
    }
    if (started && !memcmp(now, duties, sizeof now))
        return;
    started = 1;
    memcpy(duties, now, sizeof now);
    struct timespec clock;
    clock_gettime(CLOCK_MONOTONIC, &clock);
    printf("{\"t_monotonic_s\": %.6f, \"t_device_s\": %.6f, \"restarts\": %d, \"duties\": [",
           (double)clock.tv_sec + clock.tv_nsec * 1e-9, (double)avr->cycle / avr->frequency,
           restarts);
    for (int i = 0; i < COILS; i++) {
        printf("%s%.6f", i ? ", " : "", now[i] + 0.0);
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + i),
                      (uint32_t)(MID_SUPPLY_MV * (1 + now[i])));
    }
    printf("]}\n");
    fflush(stdout);
}

static avr_t *power_up(const char *path)
{
    elf_firmware_t firmware = {0};
    avr_global_logger_set(on_message);
    if (elf_read_firmware(path, &firmware))
        return NULL;
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    if (!avr || avr_init(avr))
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
    return avr;
}

int main(int count, char **arguments)
{
    avr_t *avr = count == 2 && !open_terminal() ? power_up(arguments[1]) : NULL;
    if (!avr) {
        fprintf(stderr, "usage: simulate FIRMWARE.elf\n");
        return 2;
    }
    signal(SIGTERM, on_signal);
    signal(SIGINT, on_signal);
    signal(SIGUSR1, on_signal);
    printf("%s\n", ptsname(terminal));
    while (!stopping) {
        avr_cycle_count_t end = avr->cycle + SLICE_CYCLES;
        while (avr->cycle < end)
            if (avr_run(avr) >= cpu_Done)
                return 1;
        if (resetting) {
            resetting = 0;
            restarts++;
            avr_reset(avr);
        }
        feed(avr);
        observe(avr);
    }
    return 0;
}
