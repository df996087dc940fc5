// The live meshes of a running facetd in C#: libfacet-client through P/Invoke, nothing of an engine. Linux.
//
//     using (var client = new Facet.Client(profile: Facet.Profile.Displacements, reconnect: true))
//         while (true)
//         {
//             Facet.Frame frame = client.Next(1000);
//             float[] verticesMm, normals;
//             if (frame != null && client.Mesh(out verticesMm, out normals)) ...   // [vertex count][3], head frame
//         }
//
// Arrays are copies, yours for as long as you like. What breaks the protocol, and a server that is gone, is a Facet.Error. A client that
// was disposed throws ObjectDisposedException, one that another thread is using InvalidOperationException: memory that was freed can't
// be reached. The file libfacet-client.so (facet-client-dev) lies where the loader finds it; in Unity that is Assets/Plugins.
//
// Head frame: x to the subject's left, y up, z out of the face. Camera frame: x right, y down, z forward. Both mm.

using System;
using System.Runtime.InteropServices;
using System.Text;
using System.Threading;

namespace Facet
{
    public enum Profile { Signals = 0, Displacements = 1, Vertices = 2 }
    public enum TrackingState { Searching = 0, Acquiring = 1, Tracking = 2, Lost = 3 }
    public enum Outcome { Ok = 0, Timeout = 1, Unavailable = 2, Closed = 3, BadData = 4, Overwritten = 5, NoMesh = 6, OutOfMemory = 7 }

    public sealed class Error : Exception
    {
        public readonly Outcome Outcome;
        public Error(Outcome outcome, string what) : base("facet: " + what) { Outcome = outcome; }
    }

    // What does not change from frame to frame.
    public sealed class Subject
    {
        public ulong Id;
        public string[] ExpressionNames;
        public float[] Identity;            // standard deviations
        public int VertexCount;             // of the finest level; 0 with profile Signals
        public int[] Triangles;             // [3 triangle count] counter-clockwise from outside
        public float[] TextureCoordinates;  // [VertexCount][2] u right, v up
    }

    public sealed class Albedo
    {
        public ulong SubjectId;
        public ulong Version;
        public float[] LinearRgb;  // [vertex count][3]
    }

    public sealed class Frame
    {
        public ulong Sequence;
        public long TimestampNs;  // CLOCK_MONOTONIC, start of the exposure
        public TrackingState State;
        public string DegradedReason;
        public float[] LandmarksPx;  // [landmark count][2]
        public float LatencyMs;
        public ulong SubjectId;         // 0: no mesh, and nothing below is there
        public ulong AlbedoVersion;     // 0: none yet
        public float[] CameraFromHead;  // [3][4] p_camera = CameraFromHead * p_head, mm
        public float[] Expression;      // 0 to 1, as the subject names them
        public float[] AvatarValues;    // likewise, what an avatar is to be moved by: counted from the neutral pose and tuned
    }

    /// Reads the stream; connects with the first frame that is asked for. One thread at a time.
    public sealed class Client : IDisposable
    {
        public const string DefaultSocket = "";  // what FACET_SOCKET names, else where the package's daemon listens

        readonly object gate = new object();
        IntPtr client;
        Subject subject;
        ulong subjectConnection;

        /// ring: frames through shared memory where the server offers it. reconnect: a server that is not there, or no longer, is waited for.
        /// name: for people, in the server's statistics.
        public Client(string socket = DefaultSocket, Profile profile = Profile.Displacements, bool albedo = false, bool ring = false, bool reconnect = false, string name = "csharp")
        {
            client = Library.facet_client_new(socket, (int)profile, (albedo ? 1u : 0u) | (ring ? 2u : 0u) | (reconnect ? 4u : 0u), name);
            if (client == IntPtr.Zero)
                throw new ArgumentException("facet: no client of '" + socket + "': its path is too long, its profile is unknown, or memory is out");
        }

        ~Client() { Free(); }

        public void Dispose()
        {
            Use(() => { Free(); return 0; }, true);
            GC.SuppressFinalize(this);
        }

        /// The newest frame that was not had yet; null where none comes in time. timeoutMs below 0: waits without end.
        public Frame Next(int timeoutMs)
        {
            return Use(() =>
            {
                var outcome = (Outcome)Library.facet_client_next(client, timeoutMs);
                if (outcome == Outcome.Timeout)
                    return null;
                if (outcome != Outcome.Ok)
                    throw new Error(outcome, Text(Library.facet_client_message(client)));
                var seen = Marshal.PtrToStructure<NativeFrame>(Library.facet_client_frame(client));
                return new Frame
                {
                    Sequence = seen.sequence, TimestampNs = seen.timestamp_ns, State = (TrackingState)seen.state, DegradedReason = Text(seen.degraded_reason),
                    LandmarksPx = Floats(seen.landmarks_px, 2 * (long)seen.landmark_count), LatencyMs = seen.latency_ms, SubjectId = seen.subject_id,
                    AlbedoVersion = seen.albedo_version, CameraFromHead = seen.camera_from_head, Expression = Floats(seen.expression, (long)seen.expression_count),
                    AvatarValues = Floats(seen.avatar_values, (long)seen.expression_count)
                };
            });
        }

        /// The frame's finest mesh: head frame, mm; normals of unit length. Both [vertex count][3]. False where it has none, or where it was
        /// overwritten in the ring meanwhile.
        public bool Mesh(out float[] verticesMm, out float[] normals)
        {
            float[] vertices = null, directions = null;
            bool there = Use(() =>
            {
                IntPtr pointer;
                var outcome = (Outcome)Library.facet_client_mesh(client, out pointer);
                if (outcome == Outcome.OutOfMemory)
                    throw new Error(outcome, "no memory for a mesh");
                if (outcome != Outcome.Ok)
                    return false;
                var mesh = Marshal.PtrToStructure<NativeMesh>(pointer);
                vertices = Floats(mesh.vertices_mm, 3 * (long)mesh.vertex_count);
                directions = Floats(mesh.normals, 3 * (long)mesh.vertex_count);
                return true;
            });
            verticesMm = vertices;
            normals = directions;
            return there;
        }

        /// Copied once; null before the first mesh.
        public Subject Subject
        {
            get
            {
                return Use(() =>
                {
                    IntPtr pointer = Library.facet_client_subject(client);
                    if (pointer == IntPtr.Zero)
                        return null;
                    var seen = Marshal.PtrToStructure<NativeSubject>(pointer);
                    ulong connection = Native().connections;
                    if (subject != null && subject.Id == seen.id && subjectConnection == connection)
                        return subject;
                    var names = new string[(long)seen.expression_count];
                    for (int k = 0; k < names.Length; ++k)
                        names[k] = Text(Marshal.ReadIntPtr(seen.expression_names, k * IntPtr.Size));
                    var triangles = new int[3 * (long)seen.triangle_count];
                    if (triangles.Length > 0)
                        Marshal.Copy(seen.triangles, triangles, 0, triangles.Length);
                    subjectConnection = connection;
                    return subject = new Subject
                    {
                        Id = seen.id, ExpressionNames = names, Identity = Floats(seen.identity, (long)seen.identity_count), VertexCount = (int)seen.vertex_count,
                        Triangles = triangles, TextureCoordinates = Floats(seen.texture_coordinates, 2 * (long)seen.vertex_count)
                    };
                });
            }
        }

        /// The newest that came, copied each time: ask where Frame.AlbedoVersion is another. Null before the first.
        public Albedo Albedo
        {
            get
            {
                return Use(() =>
                {
                    IntPtr pointer = Library.facet_client_albedo(client);
                    if (pointer == IntPtr.Zero)
                        return null;
                    var seen = Marshal.PtrToStructure<NativeAlbedo>(pointer);
                    var values = new short[3 * (long)seen.vertex_count];
                    if (values.Length > 0)
                        Marshal.Copy(seen.linear_rgb, values, 0, values.Length);
                    return new Albedo { SubjectId = seen.subject_id, Version = seen.version, LinearRgb = Array.ConvertAll(values, value => (ushort)value / 65535.0f * seen.scale) };
                });
            }
        }

        /// Whether frames come through shared memory now.
        public bool ByRing { get { return Use(() => Native().by_ring != 0); } }
        /// Frames that came while this client was busy, over all connections.
        public ulong Dropped { get { return Use(() => Native().dropped); } }

        // For one thread: nobody frees or refills what is being read.
        T Use<T>(Func<T> what, bool disposed = false)
        {
            if (!Monitor.TryEnter(gate))
                throw new InvalidOperationException("facet: the client is in use by another thread");
            try
            {
                if (client == IntPtr.Zero && !disposed)
                    throw new ObjectDisposedException("Facet.Client");
                return what();
            }
            finally
            {
                Monitor.Exit(gate);
            }
        }

        void Free()
        {
            Library.facet_client_free(client);
            client = IntPtr.Zero;
        }

        NativeStatistics Native() { return Marshal.PtrToStructure<NativeStatistics>(Library.facet_client_statistics(client)); }

        // What is no UTF-8 is replaced: Marshal's own conversions end the program there (Mono).
        static string Text(IntPtr text)
        {
            int length = 0;
            while (text != IntPtr.Zero && Marshal.ReadByte(text, length) != 0)
                ++length;
            var bytes = new byte[length];
            if (length > 0)
                Marshal.Copy(text, bytes, 0, length);
            return Encoding.UTF8.GetString(bytes);
        }

        static float[] Floats(IntPtr values, long count)
        {
            var copy = new float[values == IntPtr.Zero ? 0 : count];
            if (copy.Length > 0)
                Marshal.Copy(values, copy, 0, copy.Length);
            return copy;
        }

        [StructLayout(LayoutKind.Sequential)]
        struct NativeFixedPoint
        {
            public IntPtr values;
            public UIntPtr count;
            public float step_mm;
        }

        // The structs of facet-client.h, up to the last field that is read here; the library makes them, and they only ever grow.
        [StructLayout(LayoutKind.Sequential)]
        struct NativeFrame
        {
            public ulong sequence;
            public long timestamp_ns, media_time_ns;
            public int state, degraded;
            public IntPtr degraded_reason;
            public float fx, fy, cx, cy;
            public int width_px, height_px;
            public IntPtr landmarks_px;
            public UIntPtr landmark_count;
            public float reprojection_px, latency_ms;
            public ulong subject_id, albedo_version;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 12)]
            public float[] camera_from_head;
            public IntPtr expression;
            public UIntPtr expression_count;
            public float photometric_rms;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 9)]
            public float[] lighting;
            public NativeFixedPoint control_vertices, displacements, vertices;
            public IntPtr normals, confidence;
            public int in_ring;
            public IntPtr expression_confidence;
            public int origin;
            public IntPtr avatar_values;
        }

        [StructLayout(LayoutKind.Sequential)]
        struct NativeSubject
        {
            public ulong id;
            public IntPtr expression_names;
            public UIntPtr expression_count;
            public IntPtr identity;
            public UIntPtr identity_count;
            public uint control_vertex_count, vertex_count, triangle_count;
            public IntPtr triangles, texture_coordinates;
        }

        [StructLayout(LayoutKind.Sequential)]
        struct NativeAlbedo
        {
            public ulong subject_id, version;
            public float scale;
            public IntPtr linear_rgb;
            public UIntPtr vertex_count;
        }

        [StructLayout(LayoutKind.Sequential)]
        struct NativeMesh
        {
            public uint vertex_count;
            public IntPtr vertices_mm, normals;
        }

        [StructLayout(LayoutKind.Sequential)]
        struct NativeStatistics
        {
            public ulong received, dropped, overwritten, connections, bytes;
            public int by_ring;
        }

        static class Library
        {
            const string Name = "facet-client";

            [DllImport(Name)] internal static extern IntPtr facet_client_new([MarshalAs(UnmanagedType.LPStr)] string socket, int profile, uint flags, [MarshalAs(UnmanagedType.LPStr)] string name);
            [DllImport(Name)] internal static extern void facet_client_free(IntPtr client);
            [DllImport(Name)] internal static extern int facet_client_next(IntPtr client, int timeoutMs);
            [DllImport(Name)] internal static extern IntPtr facet_client_message(IntPtr client);
            [DllImport(Name)] internal static extern IntPtr facet_client_frame(IntPtr client);
            [DllImport(Name)] internal static extern IntPtr facet_client_subject(IntPtr client);
            [DllImport(Name)] internal static extern IntPtr facet_client_albedo(IntPtr client);
            [DllImport(Name)] internal static extern int facet_client_mesh(IntPtr client, out IntPtr mesh);
            [DllImport(Name)] internal static extern IntPtr facet_client_statistics(IntPtr client);
        }
    }
}
