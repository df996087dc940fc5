"""Datagrams of avatar protocols as JSON, read by what the protocols' pages say alone.

Usage: decode.py osc|live_link_face|ifacialmocap|json FILE      FILE: datagrams, each behind its length (4 bytes, little-endian)

osc: every message in order, [address, arguments...] (Open Sound Control 1.0). Of the others one object for each packet;
ifacialmocap: "values" {name: number}, and "=head", "rightEye", "leftEye", each its numbers.
"""
import json
import struct
import sys


def osc_text(data, at):
    end = data.index(b"\0", at)
    after = (end // 4 + 1) * 4
    assert not any(data[end:after]), "a text's padding is not zero"
    return data[at:end].decode(), after


def osc_packet(data):
    if data.startswith(b"#bundle\0"):
        assert data[8:16] == b"\0\0\0\0\0\0\0\1", "not 'immediately'"
        at = 16
        while at < len(data):
            (size,) = struct.unpack_from(">i", data, at)
            assert size % 4 == 0 and at + 4 + size <= len(data), "an element's size"
            yield from osc_packet(data[at + 4:at + 4 + size])
            at += 4 + size
        return
    address, at = osc_text(data, 0)
    tags, at = osc_text(data, at)
    assert tags.startswith(",")
    message = [address]
    for tag in tags[1:]:
        if tag == "s":
            value, at = osc_text(data, at)
        elif tag in "TF":
            value = tag == "T"
        else:
            (value,) = struct.unpack_from({"i": ">i", "f": ">f"}[tag], data, at)
            at += 4
        message.append(value)
    assert at == len(data), "bytes are left over"
    yield message


def live_link_face(data):
    assert data[0] == 6, "version"
    at = 1
    texts = []
    for _ in range(2):
        (size,) = struct.unpack_from(">i", data, at)
        texts.append(data[at + 4:at + 4 + size].decode())
        at += 4 + size
    frame, part, rate, denominator, count = struct.unpack_from(">ifiiB", data, at)
    values = struct.unpack_from(f">{count}f", data, at + 17)
    assert at + 17 + 4 * count == len(data), "bytes are left over"
    return {"device": texts[0], "subject": texts[1], "frame": frame, "part": part, "rate": rate,
            "denominator": denominator, "values": values}


def ifacialmocap(data):
    text = data.decode("ascii")
    assert text.endswith("|"), "the last part has no end"
    out = {"values": {}}
    for part in text[:-1].split("|"):
        if "#" in part:
            name, numbers = part.split("#")
            out[name] = [float(number) for number in numbers.split(",")]
        elif part:
            name, number = part.split("-")
            out["values"][name] = int(number)
    return out


kind, file = sys.argv[1:]
stream = open(file, "rb").read()
out = []
while stream:
    (length,) = struct.unpack_from("<I", stream)
    datagram, stream = stream[4:4 + length], stream[4 + length:]
    out += osc_packet(datagram) if kind == "osc" else [
        {"live_link_face": live_link_face, "ifacialmocap": ifacialmocap, "json": json.loads}[kind](datagram)]
print(json.dumps(out))
