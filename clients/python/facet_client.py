"""The live meshes of a running facetd, in Python: libfacet-client through ctypes, arrays of NumPy.

    import facet_client
    with facet_client.Client(profile=facet_client.DISPLACEMENTS, ring=True, reconnect=True) as client:
        for frame in client:
            print(frame.expression_of("jawOpen"))
            mesh = client.mesh()
            if mesh is not None:
                vertices_mm, normals = mesh  # [vertex_count][3] float32, head frame

Arrays are copies, yours for as long as you like. Ctrl-C ends every wait. A client that was closed raises ValueError, one
that another thread is using RuntimeError. Needs NumPy and libfacet-client (facet-client-dev); FACET_CLIENT_LIBRARY names
another file of it.
"""
import contextlib
import ctypes
import math
import os
import threading
import time
from types import SimpleNamespace

import numpy

DEFAULT_SOCKET = "/run/facet/stream.sock"  # where FACET_SOCKET names no other
SIGNALS, DISPLACEMENTS, VERTICES = range(3)
STATES = ("searching", "acquiring", "tracking", "lost")
ORIGINS = ("live", "take", "pose")
_SLICE_MS = 200  # Python runs no handler of a signal while the library waits: it waits no longer at once
_WANT_ALBEDO, _WANT_RING, _RECONNECT = 1, 2, 4
_OK, _TIMEOUT, _UNAVAILABLE, _CLOSED, _BAD_DATA, _OVERWRITTEN, _NO_MESH, _OUT_OF_MEMORY = range(8)


class Error(Exception):
    """The server is not there, said goodbye, or what it sends breaks the protocol."""


class Frame(SimpleNamespace):
    """A frame; its arrays are copies.

    origin            one of ORIGINS: what the cameras see, a recorded take, a face that somebody poses
    sequence, timestamp_ns, media_time_ns, state (one of STATES), degraded, degraded_reason, latency_ms
    camera            (fx, fy, cx, cy, width_px, height_px)
    landmarks_px      [468][2] float32; None: no face
    subject_id        0: no mesh, and nothing below is there
    albedo_version    0: none yet
    camera_from_head  [3][4] float32, p_camera = camera_from_head * p_head, mm
    expression        [expression_count] float32, 0 to 1, in the order of subject.expression_names; None: no face
    expression_names  the names of these
    expression_confidence  [expression_count] 0 to 1; None: not known
    avatar_values     [expression_count] float32, 0 to 1: what an avatar is to be moved by: expression counted from the person's
                      neutral pose and tuned by name, where the server knows one; else expression itself; None: no face
    upright_position_m, upright_rotation  [3], [4] (x y z w): where the head is and how it is turned; x to the picture's right, y up,
                      z towards the camera; None: no face
    photometric_rms   linear; lighting [9] float32
    """

    def expression_of(self, name):
        """A value by its name ("jawOpen"), 0 to 1; nan where the frame has no face. KeyError: there is no such expression."""
        return self._of(self.expression, name)

    def avatar_value_of(self, name):
        """The same of avatar_values."""
        return self._of(self.avatar_values, name)

    def _of(self, values, name):
        if values is None:
            return math.nan
        try:
            return float(values[self.expression_names.index(name)])
        except ValueError:
            raise KeyError(f"no expression '{name}': there are {', '.join(self.expression_names)}") from None


class _FixedPoint(ctypes.Structure):
    _fields_ = [("values", ctypes.POINTER(ctypes.c_int16)), ("count", ctypes.c_size_t), ("step_mm", ctypes.c_float)]


class _Frame(ctypes.Structure):
    _fields_ = [
        ("sequence", ctypes.c_uint64), ("timestamp_ns", ctypes.c_int64), ("media_time_ns", ctypes.c_int64),
        ("state", ctypes.c_int32), ("degraded", ctypes.c_int32), ("degraded_reason", ctypes.c_char_p),
        ("fx", ctypes.c_float), ("fy", ctypes.c_float), ("cx", ctypes.c_float), ("cy", ctypes.c_float),
        ("width_px", ctypes.c_int32), ("height_px", ctypes.c_int32),
        ("landmarks_px", ctypes.POINTER(ctypes.c_float)), ("landmark_count", ctypes.c_size_t),
        ("reprojection_px", ctypes.c_float), ("latency_ms", ctypes.c_float),
        ("subject_id", ctypes.c_uint64), ("albedo_version", ctypes.c_uint64), ("camera_from_head", ctypes.c_float * 12),
        ("expression", ctypes.POINTER(ctypes.c_float)), ("expression_count", ctypes.c_size_t),
        ("photometric_rms", ctypes.c_float), ("lighting", ctypes.c_float * 9),
        ("control_vertices", _FixedPoint), ("displacements", _FixedPoint), ("vertices", _FixedPoint),
        ("normals", ctypes.POINTER(ctypes.c_int16)), ("confidence", ctypes.POINTER(ctypes.c_uint8)),
        ("in_ring", ctypes.c_int32), ("expression_confidence", ctypes.POINTER(ctypes.c_uint8)),
        ("origin", ctypes.c_int32), ("avatar_values", ctypes.POINTER(ctypes.c_float)),
        ("upright_position_m", ctypes.c_float * 3), ("upright_rotation", ctypes.c_float * 4)]


class _Level(ctypes.Structure):
    _fields_ = [("vertex_count", ctypes.c_uint32), ("triangle_count", ctypes.c_uint32),
                ("triangles", ctypes.POINTER(ctypes.c_uint32))]


class _Subject(ctypes.Structure):
    _fields_ = [
        ("id", ctypes.c_uint64), ("expression_names", ctypes.POINTER(ctypes.c_char_p)), ("expression_count", ctypes.c_size_t),
        ("identity", ctypes.POINTER(ctypes.c_float)), ("identity_count", ctypes.c_size_t),
        ("control_vertex_count", ctypes.c_uint32), ("vertex_count", ctypes.c_uint32), ("triangle_count", ctypes.c_uint32),
        ("triangles", ctypes.POINTER(ctypes.c_uint32)), ("texture_coordinates", ctypes.POINTER(ctypes.c_float)),
        ("person", ctypes.c_char_p), ("neutral_mm", ctypes.POINTER(ctypes.c_float)),
        ("levels", ctypes.POINTER(_Level)), ("level_count", ctypes.c_uint32)]


class _Albedo(ctypes.Structure):
    _fields_ = [
        ("subject_id", ctypes.c_uint64), ("version", ctypes.c_uint64), ("scale", ctypes.c_float),
        ("linear_rgb", ctypes.POINTER(ctypes.c_uint16)), ("vertex_count", ctypes.c_size_t)]


class _Mesh(ctypes.Structure):
    _fields_ = [
        ("vertex_count", ctypes.c_uint32), ("vertices_mm", ctypes.POINTER(ctypes.c_float)),
        ("normals", ctypes.POINTER(ctypes.c_float))]


class _Statistics(ctypes.Structure):
    _fields_ = [(name, ctypes.c_uint64) for name in ("received", "dropped", "overwritten", "connections", "bytes")] + [
        ("by_ring", ctypes.c_int32)]


def _load():
    library = ctypes.CDLL(os.environ.get("FACET_CLIENT_LIBRARY", "libfacet-client.so.0"), use_errno=True)
    client = ctypes.c_void_p
    for name, result, arguments in (
            ("new", client, (ctypes.c_char_p, ctypes.c_int, ctypes.c_uint, ctypes.c_char_p)),
            ("free", None, (client,)),
            ("next", ctypes.c_int, (client, ctypes.c_int)),
            ("message", ctypes.c_char_p, (client,)),
            ("frame", ctypes.POINTER(_Frame), (client,)),
            ("subject", ctypes.POINTER(_Subject), (client,)),
            ("albedo", ctypes.POINTER(_Albedo), (client,)),
            ("mesh", ctypes.c_int, (client, ctypes.POINTER(ctypes.POINTER(_Mesh)))),
            ("intact", ctypes.c_int, (client,)),
            ("statistics", ctypes.POINTER(_Statistics), (client,))):
        function = getattr(library, f"facet_client_{name}")
        function.restype, function.argtypes = result, arguments
    return library


def _copy(pointer, *shape):
    """The memory behind a pointer, copied: the library uses it again for the next frame. None where there is none."""
    return numpy.array(numpy.ctypeslib.as_array(pointer, shape=shape)) if pointer else None


class Client:
    """Reads the stream; connects with the first frame that is asked for.

    socket     path; None or "": what FACET_SOCKET of the environment names, else DEFAULT_SOCKET
    profile    SIGNALS, DISPLACEMENTS or VERTICES: how much of a frame comes
    ring       frames through shared memory where the server offers it
    reconnect  a server that is not there, or no longer, is waited for
    """

    def __init__(self, socket=None, profile=DISPLACEMENTS, albedo=False, ring=False, reconnect=False, name="python"):
        self._client = None
        self._socket = os.fsdecode(socket or os.environ.get("FACET_SOCKET") or DEFAULT_SOCKET)
        self._lock = threading.Lock()
        self._subject = (None, None)  # which, and what
        self._names = (None, [])  # of which, and the names of its expressions
        self._library = _load()
        flags = (_WANT_ALBEDO if albedo else 0) | (_WANT_RING if ring else 0) | (_RECONNECT if reconnect else 0)
        self._client = self._library.facet_client_new(os.fsencode(self._socket), profile, flags, name.encode())
        if not self._client:
            raise Error(f"no client: {os.strerror(ctypes.get_errno())}")

    @contextlib.contextmanager
    def _open(self):
        """The library's client, for one thread: nobody frees or refills what is being read."""
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(f"the client of '{self._socket}' is in use by another thread")
        try:
            if not self._client:
                raise ValueError(f"the client of '{self._socket}' is closed")
            yield self._client
        finally:
            self._lock.release()

    def close(self):
        """Frees the client; arrays that it gave stay. Again: nothing."""
        if self._client:
            with self._open() as client:
                self._client = None
                self._library.facet_client_free(client)

    def __del__(self):
        if getattr(self, "_client", None):
            self.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def __iter__(self):
        """Frames until the server ends; with reconnect without end."""
        while True:
            try:
                frame = self.next(timeout_s=None)
            except ConnectionResetError:
                return
            if frame is not None:
                yield frame

    def next(self, timeout_s=1.0):
        """The newest frame that was not had yet; None where none comes in time. timeout_s None waits without end.

        Raises ConnectionResetError where the server said goodbye or is gone, Error for all else."""
        with self._open() as client:
            outcome = self._wait(client, math.inf if timeout_s is None else time.monotonic() + timeout_s)
            if outcome == _TIMEOUT:
                return None
            if outcome != _OK:
                message = self._library.facet_client_message(client).decode(errors="replace")
                raise ConnectionResetError(message) if outcome == _CLOSED else Error(message)
            frame = self._library.facet_client_frame(client).contents
            return Frame(
                sequence=frame.sequence, timestamp_ns=frame.timestamp_ns, media_time_ns=frame.media_time_ns,
                origin=ORIGINS[frame.origin], state=STATES[frame.state],
                degraded=bool(frame.degraded), degraded_reason=frame.degraded_reason.decode(errors="replace"),
                camera=(frame.fx, frame.fy, frame.cx, frame.cy, frame.width_px, frame.height_px),
                landmarks_px=_copy(frame.landmarks_px, frame.landmark_count, 2), latency_ms=frame.latency_ms,
                subject_id=frame.subject_id, albedo_version=frame.albedo_version,
                camera_from_head=numpy.array(frame.camera_from_head, numpy.float32).reshape(3, 4),
                expression=_copy(frame.expression, frame.expression_count) if frame.subject_id else None,
                expression_names=self._names_of(client) if frame.subject_id else [],
                expression_confidence=(_copy(frame.expression_confidence, frame.expression_count) / numpy.float32(255)
                                       if frame.expression_confidence else None),
                avatar_values=_copy(frame.avatar_values, frame.expression_count) if frame.subject_id else None,
                upright_position_m=numpy.array(frame.upright_position_m, numpy.float32) if frame.subject_id else None,
                upright_rotation=numpy.array(frame.upright_rotation, numpy.float32) if frame.subject_id else None,
                photometric_rms=frame.photometric_rms, lighting=numpy.array(frame.lighting, numpy.float32))

    def _wait(self, client, until):
        """facet_client_next up to a time of time.monotonic(), in slices."""
        while True:
            left_ms = math.ceil(min(max(1000 * (until - time.monotonic()), 0), _SLICE_MS))
            outcome = self._library.facet_client_next(client, left_ms)
            if outcome != _TIMEOUT or time.monotonic() >= until:
                return outcome

    def _which(self, client, subject):
        """What tells one subject from another: ids begin anew with a server."""
        return self._library.facet_client_statistics(client).contents.connections, subject.id

    def _names_of(self, client):
        """The names of the subject's expressions, read once; that of the frame is the newest."""
        subject = self._library.facet_client_subject(client).contents
        which = self._which(client, subject)
        if self._names[0] != which:
            names = [subject.expression_names[k].decode(errors="replace") for k in range(subject.expression_count)]
            self._names = which, names
        return self._names[1]

    def mesh(self):
        """(vertices_mm, normals) of the frame, [vertex_count][3] float32 each; None where it has none, or where it was
        overwritten in the ring meanwhile."""
        with self._open() as client:
            mesh = ctypes.POINTER(_Mesh)()
            outcome = self._library.facet_client_mesh(client, ctypes.byref(mesh))
            if outcome in (_NO_MESH, _OVERWRITTEN):
                return None
            if outcome != _OK:
                raise Error("no memory for a mesh")
            count = mesh.contents.vertex_count
            return _copy(mesh.contents.vertices_mm, count, 3), _copy(mesh.contents.normals, count, 3)

    @property
    def subject(self):
        """What does not change from frame to frame, copied once; None before the first mesh. Its `levels`, coarse to fine, are of
        (vertex_count, triangles [triangle_count][3]) each, over the first vertex_count vertices of the mesh."""
        with self._open() as client:
            pointer = self._library.facet_client_subject(client)
            if not pointer:
                return None
            subject = pointer.contents
            which = self._which(client, subject)
            if self._subject[0] == which:
                return self._subject[1]
            self._subject = which, SimpleNamespace(
                id=subject.id, expression_names=self._names_of(client),
                identity=_copy(subject.identity, subject.identity_count), vertex_count=subject.vertex_count,
                triangles=_copy(subject.triangles, subject.triangle_count, 3),
                texture_coordinates=_copy(subject.texture_coordinates, subject.vertex_count, 2),
                levels=[(level.vertex_count, _copy(level.triangles, level.triangle_count, 3))
                        for level in (subject.levels[k] for k in range(subject.level_count))],
                person=subject.person.decode(errors="replace") if subject.person else None,
                neutral_mm=_copy(subject.neutral_mm, subject.control_vertex_count, 3) if subject.neutral_mm else None)
            return self._subject[1]

    @property
    def albedo(self):
        """(version, linear RGB [vertex_count][3] float32); None before the first."""
        with self._open() as client:
            pointer = self._library.facet_client_albedo(client)
            if not pointer:
                return None
            albedo = pointer.contents
            return albedo.version, _copy(albedo.linear_rgb, albedo.vertex_count, 3) * numpy.float32(albedo.scale / 65535)

    @property
    def statistics(self):
        with self._open() as client:
            statistics = self._library.facet_client_statistics(client).contents
            return SimpleNamespace(**{name: getattr(statistics, name) for name, _ in _Statistics._fields_})

    @property
    def message(self):
        """Why the last frame did not come, for people."""
        with self._open() as client:
            return self._library.facet_client_message(client).decode(errors="replace")
