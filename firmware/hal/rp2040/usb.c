#include "usb.h"

#include "cortex_m.h"
#include "hal.h"
#include "ring.h"

/* Registers, and the memory that is shared with the controller (RP2040 datasheet, 4.1). */
#define MEMORY 0x50100000u
#define ENDPOINT_CONTROL_IN(n) REGISTER(MEMORY + 8u * (n))
#define ENDPOINT_CONTROL_OUT(n) REGISTER(MEMORY + 4u + 8u * (n))
#define BUFFER_CONTROL_IN(n) REGISTER(MEMORY + 0x80u + 8u * (n))
#define BUFFER_CONTROL_OUT(n) REGISTER(MEMORY + 0x84u + 8u * (n))
#define CONTROL_BUFFER 0x100u
#define NOTICE_BUFFER 0x180u
#define IN_BUFFER 0x1C0u
#define OUT_BUFFER 0x200u

#define ADDRESS REGISTER(0x50110000u)
#define MAIN_CONTROL REGISTER(0x50110040u)
#define SIE_CONTROL REGISTER(0x5011004Cu)
#define SIE_STATUS REGISTER(0x50110050u)
#define BUFFER_STATUS REGISTER(0x50110058u)
#define STALL_ARM REGISTER(0x50110068u)
#define MUXING REGISTER(0x50110074u)
#define POWER REGISTER(0x50110078u)
#define INTERRUPT_ENABLE REGISTER(0x50110090u)
#define NVIC_PEND REGISTER(0xE000E200u)
#define USB_IRQ 5u

#define SETUP_RECEIVED (1u << 17)         /* SIE_STATUS */
#define BUS_RESET (1u << 19)              /* SIE_STATUS */
#define INTERRUPT_EACH_BUFFER (1u << 29)  /* SIE_CONTROL and ENDPOINT_CONTROL */
#define PULL_UP (1u << 16)                /* SIE_CONTROL */
#define ENDPOINT_ENABLE (1u << 31)
#define TYPE_BULK (2u << 26)
#define TYPE_INTERRUPT (3u << 26)
#define FULL (1u << 15) /* BUFFER_CONTROL */
#define DATA1 (1u << 13)
#define STALL (1u << 11)
#define AVAILABLE (1u << 10)
#define LENGTH 0x3FFu
#define BUFFERS_INTERRUPT (1u << 4)
#define RESET_INTERRUPT (1u << 12)
#define SETUP_INTERRUPT (1u << 16)

#define PACKET 64u
#define NOTICE_ENDPOINT 1u
#define DATA_ENDPOINT 2u

/* Requests (USB 2.0, 9.4; CDC PSTN 1.2, 6.3). */
#define GET_STATUS 0x80u
#define GET_DESCRIPTOR 0x80u
#define TO_DEVICE 0x00u
#define TO_ENDPOINT 0x02u
#define CLASS_OUT 0x21u
#define CLASS_IN 0xA1u

enum {
    CLEAR_FEATURE = 1,
    SET_ADDRESS = 5,
    DESCRIPTOR = 6,
    GET_CONFIGURATION = 8,
    SET_CONFIGURATION = 9,
    SET_LINE_CODING = 0x20,
    GET_LINE_CODING = 0x21,
    SET_LINES = 0x22
};

enum { OF_DEVICE = 1, OF_CONFIGURATION = 2, STRING = 3 };

#define WORD(value) ((value) & 0xFFu), ((value) >> 8)

static const uint8_t device_descriptor[] = {
    18, OF_DEVICE, WORD(0x0200), 0xEF, 2, 1, PACKET,     /* several interfaces, bound by an association */
    WORD(0x1209), WORD(0x0001), WORD(0x0100), 1, 2, 3, 1 /* pid.codes' number for tests: it has no own one yet */
};

#define CONFIGURATION_BYTES 75u

static const uint8_t configuration_descriptor[CONFIGURATION_BYTES] = {
    9, OF_CONFIGURATION, WORD(CONFIGURATION_BYTES), 2, 1, 0, 0x80, 50, /* 100 mA from the bus */
    8, 11, 0, 2, 2, 2, 0, 0,                                           /* association: a serial port */
    9, 4, 0, 0, 1, 2, 2, 0, 0,                                         /* interface 0: its control */
    5, 0x24, 0, WORD(0x0110),                                          /* CDC 1.1 */
    5, 0x24, 1, 0, 1,                                                  /* no calls */
    4, 0x24, 2, 2,                                                     /* line coding and state */
    5, 0x24, 6, 0, 1,                                                  /* both interfaces are one */
    7, 5, 0x80u | NOTICE_ENDPOINT, 3, WORD(8), 255,                    /* notices, of which it has none */
    9, 4, 1, 0, 2, 10, 0, 0, 0,                                        /* interface 1: the bytes */
    7, 5, DATA_ENDPOINT, 2, WORD(PACKET), 0,                           /* from the host */
    7, 5, 0x80u | DATA_ENDPOINT, 2, WORD(PACKET), 0                    /* to the host */
};

static const char maker[] = "inteco-abs";
static const char product[] = "open board";
static char serial_number[17];

static ring_t received, sent;
static const uint8_t *answer; /* what is left of a control answer */
static uint32_t answer_left;
static bool answer_ends_short; /* a packet shorter than PACKET must end it */
static uint8_t text[2u + 2u * 16u];
static uint8_t line_coding[7] = {0x00, 0xC2, 0x01, 0x00, 0, 0, 8}; /* 115 200 bit/s, 8N1: of no effect */
static uint8_t new_address, configuration;
static bool line_coding_follows;
static uint32_t control_pid, in_pid, out_pid;
static bool in_busy, out_armed, must_end;

static uint8_t *memory(uint32_t offset) {
    return (uint8_t *)(MEMORY + offset);
}

/* Hands a buffer to the controller. It runs at 48 MHz: the mark must follow the rest by three of its cycles. */
static void arm(volatile uint32_t *control, uint32_t value) {
    *control = value;
    __asm__ volatile("nop\n nop\n nop\n nop\n nop\n nop\n nop\n nop\n nop\n nop\n nop\n nop");
    *control = value | AVAILABLE;
}

static void send_control(uint32_t length) {
    arm(&BUFFER_CONTROL_IN(0u), FULL | control_pid | length);
    control_pid ^= DATA1;
}

/* Sends the next packet of the answer. */
static void continue_answer(void) {
    const uint32_t length = (answer_left < PACKET) ? answer_left : PACKET;
    for (uint32_t i = 0; i < length; i++) {
        memory(CONTROL_BUFFER)[i] = answer[i];
    }
    answer = &answer[length];
    answer_left -= length;
    answer_ends_short = answer_ends_short && (length == PACKET);
    send_control(length);
}

static void give(const uint8_t *bytes, uint32_t length, uint32_t wanted) {
    answer = bytes;
    answer_left = (length < wanted) ? length : wanted;
    answer_ends_short = length < wanted;
    continue_answer();
}

static void give_text(const char *letters, uint32_t wanted) {
    uint32_t length = 2u;
    for (; *letters != '\0'; letters++) {
        text[length] = (uint8_t)*letters;
        text[length + 1u] = 0u;
        length += 2u;
    }
    text[0] = (uint8_t)length;
    text[1] = STRING;
    give(text, length, wanted);
}

static void refuse(void) {
    STALL_ARM = 3u;
    BUFFER_CONTROL_IN(0u) = STALL;
    BUFFER_CONTROL_OUT(0u) = STALL;
}

static void give_descriptor(uint32_t kind, uint32_t index, uint32_t wanted) {
    static const uint8_t languages[] = {4, STRING, WORD(0x0409)};
    if (kind == OF_DEVICE) {
        give(device_descriptor, sizeof device_descriptor, wanted);
    } else if (kind == OF_CONFIGURATION) {
        give(configuration_descriptor, sizeof configuration_descriptor, wanted);
    } else if ((kind == STRING) && (index == 0u)) {
        give(languages, sizeof languages, wanted);
    } else if ((kind == STRING) && (index <= 3u)) {
        give_text((index == 1u) ? maker : ((index == 2u) ? product : serial_number), wanted);
    } else {
        refuse();
    }
}

static void receive_next(void) {
    if (!out_armed && (configuration != 0u) && (ring_free(&received) >= PACKET)) {
        out_armed = true;
        arm(&BUFFER_CONTROL_OUT(DATA_ENDPOINT), out_pid | PACKET);
    }
}

/* Sends what waits for the host. A transfer that ends with a full packet needs an empty one, or the host waits on. */
static void send_next(void) {
    const uint32_t waiting = ring_used(&sent);
    const uint32_t length = (waiting < PACKET) ? waiting : PACKET;
    if (in_busy || (configuration == 0u) || ((length == 0u) && !must_end)) {
        return;
    }
    for (uint32_t i = 0; i < length; i++) {
        memory(IN_BUFFER)[i] = ring_take(&sent);
    }
    must_end = length == PACKET;
    in_busy = true;
    arm(&BUFFER_CONTROL_IN(DATA_ENDPOINT), FULL | in_pid | length);
    in_pid ^= DATA1;
}

static void drop_what_waits(void) {
    while (ring_used(&sent) > 0u) {
        (void)ring_take(&sent);
    }
}

static void configure(uint32_t value) {
    configuration = (uint8_t)value;
    in_pid = 0u;
    out_pid = 0u;
    in_busy = false;
    out_armed = false;
    must_end = false;
    BUFFER_CONTROL_IN(DATA_ENDPOINT) = 0u;
    BUFFER_CONTROL_OUT(DATA_ENDPOINT) = 0u;
    drop_what_waits();
}

static void on_setup(void) {
    const uint8_t *const request = memory(0u);
    const uint32_t value = request[2] | ((uint32_t)request[3] << 8);
    const uint32_t wanted = request[6] | ((uint32_t)request[7] << 8);
    static const uint8_t status[2];
    control_pid = DATA1;
    line_coding_follows = false;
    if ((request[0] == GET_DESCRIPTOR) && (request[1] == DESCRIPTOR)) {
        give_descriptor(value >> 8, value & 0xFFu, wanted);
    } else if ((request[0] == GET_DESCRIPTOR) && (request[1] == GET_CONFIGURATION)) {
        give(&configuration, 1u, wanted);
    } else if (((request[0] & 0xFCu) == GET_STATUS) && (request[1] == 0u)) {
        give(status, sizeof status, wanted);
    } else if ((request[0] == CLASS_IN) && (request[1] == GET_LINE_CODING)) {
        give(line_coding, sizeof line_coding, wanted);
    } else if ((request[0] == CLASS_OUT) && (request[1] == SET_LINE_CODING)) {
        line_coding_follows = true;
        arm(&BUFFER_CONTROL_OUT(0u), DATA1 | PACKET);
    } else if ((request[0] == TO_DEVICE) && (request[1] == SET_ADDRESS)) {
        new_address = (uint8_t)value;
        send_control(0u);
    } else if ((request[0] == TO_DEVICE) && (request[1] == SET_CONFIGURATION)) {
        configure(value);
        send_control(0u);
    } else if ((request[0] == CLASS_OUT) && (request[1] == SET_LINES)) {
        drop_what_waits(); /* answers to a program that has left, or to the one before */
        send_control(0u);
    } else if ((request[0] == TO_ENDPOINT) && (request[1] == CLEAR_FEATURE)) {
        if (request[4] == (0x80u | DATA_ENDPOINT)) {
            in_pid = 0u;
        }
        send_control(0u);
    } else {
        refuse();
    }
}

static void on_control_sent(void) {
    if (new_address != 0u) {
        ADDRESS = new_address;
        new_address = 0u;
    } else if ((answer_left > 0u) || answer_ends_short) {
        continue_answer();
    } else if ((memory(0u)[0] & 0x80u) != 0u) {
        arm(&BUFFER_CONTROL_OUT(0u), DATA1); /* the host's empty packet that ends it */
    } else {
        /* the board's empty packet has ended it */
    }
}

static void on_control_received(void) {
    if (line_coding_follows) {
        line_coding_follows = false;
        for (uint32_t i = 0; i < sizeof line_coding; i++) {
            line_coding[i] = memory(CONTROL_BUFFER)[i];
        }
        send_control(0u);
    }
}

static void on_received(void) {
    const uint32_t length = BUFFER_CONTROL_OUT(DATA_ENDPOINT) & LENGTH;
    for (uint32_t i = 0; i < length; i++) {
        ring_put(&received, memory(OUT_BUFFER)[i]); /* it was armed only while PACKET bytes were free */
    }
    out_pid ^= DATA1;
    out_armed = false;
}

static void on_buffers(void) {
    const uint32_t done = BUFFER_STATUS;
    BUFFER_STATUS = done;
    if ((done & 1u) != 0u) {
        on_control_sent();
    }
    if ((done & 2u) != 0u) {
        on_control_received();
    }
    if ((done & (1u << (2u * DATA_ENDPOINT))) != 0u) {
        in_busy = false;
    }
    if ((done & (2u << (2u * DATA_ENDPOINT))) != 0u) {
        on_received();
    }
}

void usb_interrupt(void) {
    const uint32_t status = SIE_STATUS;
    if ((status & BUS_RESET) != 0u) {
        SIE_STATUS = BUS_RESET;
        ADDRESS = 0u;
        new_address = 0u;
        configure(0u);
    }
    if ((status & SETUP_RECEIVED) != 0u) {
        SIE_STATUS = SETUP_RECEIVED;
        answer_left = 0u;
        answer_ends_short = false;
        on_setup();
    }
    if (BUFFER_STATUS != 0u) {
        on_buffers();
    }
    receive_next();
    send_next();
}

void usb_start(uint64_t serial) {
    static const char digits[] = "0123456789ABCDEF";
    for (uint32_t i = 0; i < 16u; i++) {
        serial_number[i] = digits[(serial >> (60u - 4u * i)) & 0xFu];
    }
    for (uint32_t i = 0; i < 0x100u; i += 4u) {
        REGISTER(MEMORY + i) = 0u;
    }
    ENDPOINT_CONTROL_IN(NOTICE_ENDPOINT) = ENDPOINT_ENABLE | TYPE_INTERRUPT | NOTICE_BUFFER;
    ENDPOINT_CONTROL_IN(DATA_ENDPOINT) = ENDPOINT_ENABLE | INTERRUPT_EACH_BUFFER | TYPE_BULK | IN_BUFFER;
    ENDPOINT_CONTROL_OUT(DATA_ENDPOINT) = ENDPOINT_ENABLE | INTERRUPT_EACH_BUFFER | TYPE_BULK | OUT_BUFFER;
    MUXING = (1u << 0) | (1u << 3); /* to the chip's own transceiver, connected by software */
    POWER = (1u << 3) | (1u << 2);  /* as if the bus's voltage were seen: the Pico has no pin for it */
    MAIN_CONTROL = 1u;
    SIE_CONTROL = INTERRUPT_EACH_BUFFER;
    INTERRUPT_ENABLE = BUFFERS_INTERRUPT | RESET_INTERRUPT | SETUP_INTERRUPT;
    SIE_CONTROL = INTERRUPT_EACH_BUFFER | PULL_UP;
}

void usb_resume(void) {
    if (!out_armed && (configuration != 0u) && (ring_free(&received) >= PACKET)) {
        NVIC_PEND = 1u << USB_IRQ;
    }
}

int hal_receive(void) {
    return (ring_used(&received) > 0u) ? (int)ring_take(&received) : -1;
}

/* The interrupt sends it: only there the buffers are handled, so that none is touched twice at a time. */
bool hal_send(const uint8_t *bytes, unsigned count) {
    if (ring_free(&sent) < count) {
        return false;
    }
    for (unsigned i = 0; i < count; i++) {
        ring_put(&sent, bytes[i]);
    }
    NVIC_PEND = 1u << USB_IRQ;
    return true;
}
