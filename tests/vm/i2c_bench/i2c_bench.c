// SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-only
/*
 * An I2C bus with EEPROMs for tests, with plain transfers, which the kernel's i2c-stub has not.
 *
 * eeproms=0x50,0x51: EEPROMs of 64 KiB with 16-bit places, blank (0xff). Whoever is not listed does not answer.
 * While running, in /sys/module/i2c_bench/parameters:
 *   absent   address that does not answer (a cartridge that was taken out); 0: all are there
 *   fail     how many of the next transfers fail, with
 *   error    this errno (EIO where left alone; 110: the bus hangs until its time is over)
 */
#include <linux/delay.h>
#include <linux/i2c.h>
#include <linux/module.h>
#include <linux/platform_device.h>

#define MAX_EEPROMS 4

static int eeproms[MAX_EEPROMS], n_eeproms;
module_param_array(eeproms, int, &n_eeproms, 0444);
static int absent;
module_param(absent, int, 0644);
static int fail;
module_param(fail, int, 0644);
static int error = EIO;
module_param(error, int, 0644);

static u8 memory[MAX_EEPROMS][65536];
static u16 place[MAX_EEPROMS];

static int one_message(struct i2c_msg *message)
{
	int which, at = 0;

	for (which = 0; which < n_eeproms; which++)
		if (eeproms[which] == message->addr)
			break;
	if (which == n_eeproms || absent == message->addr)
		return -ENXIO;
	if (message->flags & I2C_M_RD) {
		for (; at < message->len; at++)
			message->buf[at] = memory[which][place[which]++];
		return 0;
	}
	if (message->len >= 2) {
		place[which] = message->buf[0] << 8 | message->buf[1];
		at = 2;
	}
	for (; at < message->len; at++)
		memory[which][place[which]++] = message->buf[at];
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

	memset(memory, 0xff, sizeof(memory));
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
MODULE_DESCRIPTION("I2C bus with EEPROMs for tests");
