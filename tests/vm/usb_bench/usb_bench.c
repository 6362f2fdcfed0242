// SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-only
/*
 * Gives the kernel's USB controller without hardware, vhci_hcd.0, what a real one has of the device tree or ACPI: a name
 * in firmware_node/path. libcamera names a camera on USB by that, and leaves one out that it cannot name.
 */
#include <linux/device.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/sysfs.h>

static ssize_t path_show(struct device *device, struct device_attribute *attribute, char *out)
{
	return sysfs_emit(out, "\\_SB_.VHCI\n");
}
static DEVICE_ATTR_RO(path);

static struct attribute *attributes[] = { &dev_attr_path.attr, NULL };
static const struct attribute_group group = { .name = "firmware_node", .attrs = attributes };
static struct device *controller;

static int __init start(void)
{
	int problem;

	controller = bus_find_device_by_name(&platform_bus_type, NULL, "vhci_hcd.0");
	if (!controller)
		return -ENODEV;
	problem = sysfs_create_group(&controller->kobj, &group);
	if (problem)
		put_device(controller);
	return problem;
}

static void __exit stop(void)
{
	sysfs_remove_group(&controller->kobj, &group);
	put_device(controller);
}

module_init(start);
module_exit(stop);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("Firmware's name of a USB controller for tests");
