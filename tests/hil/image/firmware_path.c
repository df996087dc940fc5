// SPDX-License-Identifier: GPL-2.0
/*
 * libcamera 0.0.3 names a USB camera after the nearest ancestor that the firmware describes, by reading
 * firmware_node/path of each; without one it refuses the camera. The host controller of USB/IP (vhci_hcd) is no
 * firmware's: this module gives its device such a file. It may go when libcamera falls back to the device's own path.
 */
#include <linux/device.h>
#include <linux/module.h>
#include <linux/platform_device.h>

static struct device *controller;

static ssize_t path_show(struct device *dev, struct device_attribute *attr, char *buf)
{
	return sysfs_emit(buf, "\\_SB.VHCI\n");
}
static DEVICE_ATTR_RO(path);

static struct attribute *firmware_attrs[] = { &dev_attr_path.attr, NULL };
static const struct attribute_group firmware_group = { .name = "firmware_node", .attrs = firmware_attrs };

static int __init firmware_path_init(void)
{
	int result;

	controller = bus_find_device_by_name(&platform_bus_type, NULL, "vhci_hcd.0");
	if (!controller)
		return -ENODEV;
	result = sysfs_create_group(&controller->kobj, &firmware_group);
	if (result)
		put_device(controller);
	return result;
}

static void __exit firmware_path_exit(void)
{
	sysfs_remove_group(&controller->kobj, &firmware_group);
	put_device(controller);
}

module_init(firmware_path_init);
module_exit(firmware_path_exit);
MODULE_DESCRIPTION("A firmware path for the USB/IP host controller");
MODULE_LICENSE("GPL");
