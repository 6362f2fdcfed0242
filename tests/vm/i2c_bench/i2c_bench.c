// SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-only
/*
 * An I2C bus with chips for tests, with plain transfers, which the kernel's i2c-stub has not. All are plain memory.
 *
 * eeproms=0x50,0x51: EEPROMs of 64 KiB with 16-bit places, blank (0xff). Whoever is not listed does not answer.
 * registers=0x15: chips with 128 registers of 8 bits; bit 7 of the place, "go on to the next", counts for nothing.
 * words=0x48: chips with 128 registers of 16 bits, high byte first.
 * While running, in /sys/module/i2c_bench/parameters:
 *   absent   address that does not answer (a cartridge that was taken out); 0: all are there
 *   fail     how many of the next transfers fail, with
 *   error    this errno (EIO where left alone; 110: the bus hangs until its time is over)
 */
#include <linux/delay.h>
#include <linux/i2c.h>
#include <linux/module.h>
#include <linux/platform_device.h>

#define MOST 4

static int eeproms[MOST], registers[MOST], words[MOST], n_eeproms, n_registers, n_words;
module_param_array(eeproms, int, &n_eeproms, 0444);
module_param_array(registers, int, &n_registers, 0444);
module_param_array(words, int, &n_words, 0444);
static int absent;
module_param(absent, int, 0644);
static int fail;
module_param(fail, int, 0644);
static int error = EIO;
module_param(error, int, 0644);

static struct chip {
	int address, place_bytes, width;
	u16 place;
	u8 memory[65536];
} chips[3 * MOST];
static int n_chips;

static void add(const int *addresses, int n, int place_bytes, int width, u8 blank)
{
	for (; n > 0; n--, n_chips++) {
		struct chip *chip = &chips[n_chips];

		chip->address = *addresses++;
		chip->place_bytes = place_bytes;
		chip->width = width;
		memset(chip->memory, blank, sizeof(chip->memory));
	}
}

static int one_message(struct i2c_msg *message)
{
	struct chip *chip = chips;
	int at = 0;

	while (chip < chips + n_chips && chip->address != message->addr)
		chip++;
	if (chip == chips + n_chips || absent == message->addr)
		return -ENXIO;
	if (message->flags & I2C_M_RD) {
		for (; at < message->len; at++)
			message->buf[at] = chip->memory[chip->place++];
		return 0;
	}
	if (message->len >= chip->place_bytes) {
		at = chip->place_bytes;
		chip->place = at == 2 ? message->buf[0] << 8 | message->buf[1] : (message->buf[0] & 0x7f) * chip->width;
	}
	for (; at < message->len; at++)
		chip->memory[chip->place++] = message->buf[at];
	return 0;
}

static int transfer(struct i2c_adapter *adapter, struct i2c_msg *messages, int n)
{
	int i, problem;

	if (fail > 0) {
		fail--;
		if (error == ETIMEDOUT)
			msleep(20);
		return -error;
	}
	for (i = 0; i < n; i++) {
		problem = one_message(&messages[i]);
		if (problem)
			return problem;
	}
	return n;
}

static u32 functionality(struct i2c_adapter *adapter)
{
	return I2C_FUNC_I2C | I2C_FUNC_SMBUS_EMUL;
}

static const struct i2c_algorithm algorithm = {
	.master_xfer = transfer,
	.functionality = functionality,
};
static struct i2c_adapter adapter = {
	.owner = THIS_MODULE,
	.name = "ruffini test bench",
	.algo = &algorithm,
};
static struct platform_device *device;

static int __init start(void)
{
	int problem;

	add(eeproms, n_eeproms, 2, 1, 0xff);
	add(registers, n_registers, 1, 1, 0);
	add(words, n_words, 1, 2, 0);
	device = platform_device_register_simple("i2c-bench", -1, NULL, 0);
	if (IS_ERR(device))
		return PTR_ERR(device);
	adapter.dev.parent = &device->dev;
	problem = i2c_add_adapter(&adapter);
	if (problem)
		platform_device_unregister(device);
	return problem;
}

static void __exit stop(void)
{
	i2c_del_adapter(&adapter);
	platform_device_unregister(device);
}

module_init(start);
module_exit(stop);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("I2C bus with plain memories for tests");
