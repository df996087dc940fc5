// The messages of Facet's stream (docs/stream-protocol.md, daemon/stream/facet.fbs) in plain C#: nothing of an engine, no library.
// Bytes from outside: every offset and length is checked before it is followed, every index before it is given out. Whatever breaks
// a rule is one exception, Facet.FormatException, with a sentence that says which. Any thread.
//
// Head frame: x to the subject's left, y up, z out of the face. Camera frame: x right, y down, z forward. Both mm.

using System;
using System.Text;

namespace Facet
{
    public sealed class FormatException : Exception
    {
        public FormatException(string what) : base("facet: " + what) { }
    }

    public enum MessageKind { Hello = 1, Subscribe = 2, Dropped = 3, Goodbye = 4, Subject = 5, Albedo = 6, Frame = 7, Ring = 8 }
    public enum Profile : byte { Signals = 0, Displacements = 1, Vertices = 2 }
    public enum TrackingState { Searching = 0, Acquiring = 1, Tracking = 2, Lost = 3 }

    public sealed class Level
    {
        public int VertexCount;
        public int[] Triangles;   // [3 triangle count] counter-clockwise from outside
        public int[] RowOffsets;  // [VertexCount + 1] this and the next two: profile Displacements alone, else null
        public int[] Columns;     // vertices of the next coarser level
        public float[] Weights;
    }

    // What does not change from frame to frame.
    public sealed class Subject
    {
        public ulong Id;
        public string[] ExpressionNames;
        public float[] Identity;            // standard deviations
        public int ControlVertexCount;      // profile Displacements, else 0
        public Level[] Levels;              // coarse to fine; none with profile Signals
        public float[] TextureCoordinates;  // [VertexCount][2] u right, v up
        public int VertexCount { get { return Levels.Length == 0 ? 0 : Levels[Levels.Length - 1].VertexCount; } }
        public int[] Triangles { get { return Levels.Length == 0 ? new int[0] : Levels[Levels.Length - 1].Triangles; } }
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
        public float LatencyMs;
        public ulong SubjectId;       // 0: no mesh, and nothing below is there
        public ulong AlbedoVersion;   // 0: none yet
        public float[] CameraFromHead;    // [3][4] p_camera = CameraFromHead * p_head, mm
        public float[] Expression;        // 0 to 1, as the subject names them
        public float[] ControlVerticesMm; // [control vertex count][3] profile Displacements
        public float[] DisplacementsMm;   // [vertex count] profile Displacements; null where not refined
        public float[] VerticesMm;        // [vertex count][3] profile Vertices; else Mesh.Rebuild makes them
        public float[] Normals;           // the same
    }

    public static class Message
    {
        public const uint ProtocolVersion = 1;
        public const int MostBytes = 64 << 20;
        public const int MostVertices = 500000;
        const int MostLevels = 12, MostCoefficients = 1024, MostNameBytes = 64, MostTextBytes = 1024, MostEntriesARow = 64;

        /// The kind of a message: its bytes without the socket's header of 8 bytes (a WebSocket's message is that already). A kind that is
        /// not in MessageKind is of a later release: skip it.
        public static MessageKind KindOf(byte[] message)
        {
            var reader = new Reader(message);
            return (MessageKind)reader.U8(reader.Need(reader.Root(), 0, 1, "it has no kind"));
        }

        public static uint ReadHello(byte[] message)
        {
            var reader = new Reader(message);
            return reader.GetU32(reader.Body(MessageKind.Hello), 0);
        }

        /// How many frames this reader missed since it connected.
        public static ulong ReadDropped(byte[] message)
        {
            var reader = new Reader(message);
            return reader.GetU64(reader.Body(MessageKind.Dropped), 1);
        }

        public static string ReadGoodbye(byte[] message)
        {
            var reader = new Reader(message);
            return reader.Text(reader.Body(MessageKind.Goodbye), 0, MostTextBytes);
        }

        public static Subject ReadSubject(byte[] message)
        {
            var reader = new Reader(message);
            int body = reader.Body(MessageKind.Subject);
            var subject = new Subject { Id = reader.GetU64(body, 0), Levels = new Level[0], TextureCoordinates = new float[0] };
            Require(subject.Id != 0, "subject: id is 0");
            int[] names = reader.Tables(body, 1, MostCoefficients, "subject: number of expressions");
            subject.ExpressionNames = new string[names.Length];
            for (int k = 0; k < names.Length; ++k)
                subject.ExpressionNames[k] = reader.TextAt(names[k], MostNameBytes);
            subject.Identity = reader.Floats(body, 2);
            Require(subject.Identity.Length <= MostCoefficients, "subject: identity");
            int hierarchy = reader.Table(body, 4);
            if (hierarchy == 0)
                return subject;
            uint control = reader.GetU32(hierarchy, 1);
            Require(control <= MostVertices, "hierarchy: control vertex count");
            subject.ControlVertexCount = (int)control;
            int[] levels = reader.Tables(hierarchy, 2, MostLevels, "hierarchy: number of levels");
            Require(levels.Length >= 1 && (control > 0 || levels.Length == 1), "hierarchy: number of levels");
            subject.Levels = new Level[levels.Length];
            int coarser = subject.ControlVertexCount;
            for (int k = 0; k < levels.Length; ++k)
            {
                subject.Levels[k] = ReadLevel(reader, levels[k], coarser, control > 0);
                Require(k == 0 || subject.Levels[k].VertexCount >= coarser, "hierarchy: a finer level is smaller");
                coarser = subject.Levels[k].VertexCount;
            }
            subject.TextureCoordinates = reader.Floats(hierarchy, 3);
            Require(subject.TextureCoordinates.Length == 2 * coarser, "hierarchy: texture coordinates");
            return subject;
        }

        public static Albedo ReadAlbedo(byte[] message)
        {
            var reader = new Reader(message);
            int body = reader.Body(MessageKind.Albedo);
            var albedo = new Albedo { SubjectId = reader.GetU64(body, 0), Version = reader.GetU64(body, 1) };
            float scale = reader.GetFloat(body, 2);
            ushort[] values = new ushort[reader.Vector(body, 3, 2).Count];
            reader.Copy(reader.Vector(body, 3, 2), 2, values);
            Require(albedo.SubjectId != 0 && albedo.Version != 0 && scale > 0, "albedo: id, version or scale");
            Require(values.Length % 3 == 0 && values.Length <= 3 * MostVertices, "albedo: number of values");
            albedo.LinearRgb = new float[values.Length];
            for (int k = 0; k < values.Length; ++k)
                albedo.LinearRgb[k] = values[k] / 65535.0f * scale;
            return albedo;
        }

        /// The subject that a frame names; 0: it has no mesh.
        public static ulong SubjectOfFrame(byte[] message)
        {
            var reader = new Reader(message);
            return reader.GetU64(reader.Body(MessageKind.Frame), 9);
        }

        /// subject: the one that the frame names; null only where it names none.
        public static Frame ReadFrame(byte[] message, Subject subject)
        {
            var reader = new Reader(message);
            int body = reader.Body(MessageKind.Frame);
            var frame = new Frame
            {
                Sequence = reader.GetU64(body, 0),
                TimestampNs = (long)reader.GetU64(body, 1),
                State = (TrackingState)reader.GetU8(body, 3),
                DegradedReason = reader.Text(body, 5, MostTextBytes),
                SubjectId = reader.GetU64(body, 9)
            };
            Require(frame.State <= TrackingState.Lost, "frame: unknown tracking state");
            int stages = reader.Table(body, 7);
            frame.LatencyMs = stages != 0 ? reader.GetFloat(stages, 9) : 0;
            if (frame.SubjectId == 0)
                return frame;
            Require(subject != null && subject.Id == frame.SubjectId, "frame: its subject was not sent");
            int pose = reader.Need(body, 10, 48, "frame: mesh without pose");
            frame.CameraFromHead = new float[12];
            for (int k = 0; k < 12; ++k)
                frame.CameraFromHead[k] = reader.Float(pose + 4 * k);
            Require(IsPose(frame.CameraFromHead), "frame: pose is not a rotation and a translation");
            frame.Expression = reader.Floats(body, 11);
            Require(frame.Expression.Length == subject.ExpressionNames.Length, "frame: expression");
            frame.AlbedoVersion = reader.GetU64(body, 15);
            if (subject.ControlVertexCount > 0)
            {
                frame.ControlVerticesMm = FixedPoint(reader, body, 16, 3 * subject.ControlVertexCount, "frame: control vertices");
                if (reader.Field(body, 17, 4) != 0)
                    frame.DisplacementsMm = FixedPoint(reader, body, 17, subject.VertexCount, "frame: displacements");
            }
            else if (subject.VertexCount > 0)
            {
                frame.VerticesMm = FixedPoint(reader, body, 18, 3 * subject.VertexCount, "frame: vertices");
                frame.Normals = Scaled(reader, reader.Vector(body, 19, 2), 3 * subject.VertexCount, 1.0f / 32767.0f, "frame: normals");
            }
            return frame;
        }

        /// A Subscribe message, without the socket's header. client: for people, 64 bytes of it at most.
        public static byte[] Subscribe(Profile profile, bool wantAlbedo, string client)
        {
            // Offsets by hand: root, identifier, Message {type, body} with its vtable, Subscribe with its own, the name.
            byte[] name = Encoding.ASCII.GetBytes(client);
            int length = Math.Min(name.Length, MostNameBytes);
            var message = new byte[64 + length + 8 - length % 4];
            int at = 0;
            Action<uint, int> put = (value, bytes) =>
            {
                for (int k = 0; k < bytes; ++k)
                    message[at++] = (byte)(value >> 8 * k);
            };
            put(16, 4);
            Encoding.ASCII.GetBytes("FCT1").CopyTo(message, 4);
            at = 8;  // Message's vtable
            foreach (uint entry in new uint[] { 8, 12, 8, 4 })
                put(entry, 2);
            put(8, 4);  // at 16: Message
            put(24, 4);  // body: from 20 to 44
            put((uint)MessageKind.Subscribe, 4);
            foreach (uint entry in new uint[] { 12, 16, 4, 12, 13, 8, 0, 0 })  // at 28: Subscribe's vtable, and padding
                put(entry, 2);
            put(16, 4);  // at 44: Subscribe
            put(ProtocolVersion, 4);
            put(8, 4);  // name: from 52 to 60
            put((uint)profile, 1);
            put(wantAlbedo ? 1u : 0u, 3);
            put((uint)length, 4);
            Array.Copy(name, 0, message, at, length);
            return message;
        }

        internal static void Require(bool holds, string what)
        {
            if (!holds)
                throw new FormatException(what);
        }

        static Level ReadLevel(Reader reader, int table, int coarser, bool withStencils)
        {
            uint count = reader.GetU32(table, 0);
            Require(count > 0 && count <= MostVertices, "level: vertex count");
            var level = new Level { VertexCount = (int)count, Triangles = reader.Indices(table, 1, 3 * (2 * MostVertices + 2), "level: triangle count") };
            Require(level.Triangles.Length > 0 && level.Triangles.Length % 3 == 0, "level: triangle count");
            foreach (int vertex in level.Triangles)
                Require(vertex >= 0 && vertex < level.VertexCount, "level: triangle names a vertex that is not there");
            if (!withStencils)
                return level;
            int stencils = reader.Table(table, 2);
            Require(stencils != 0, "a level has no stencils");
            level.RowOffsets = reader.Indices(stencils, 0, MostVertices + 1, "stencils: number of rows");
            level.Columns = reader.Indices(stencils, 1, MostEntriesARow * level.VertexCount, "stencils: too many entries");
            level.Weights = reader.Floats(stencils, 2);
            Require(level.RowOffsets.Length == level.VertexCount + 1, "stencils: number of rows");
            Require(level.Weights.Length == level.Columns.Length, "stencils: numbers of columns and weights differ");
            Require(level.RowOffsets[0] == 0 && level.RowOffsets[level.VertexCount] == level.Columns.Length, "stencils: row offsets");
            for (int row = 0; row < level.VertexCount; ++row)
                Require(level.RowOffsets[row] <= level.RowOffsets[row + 1], "stencils: row offsets");
            foreach (int column in level.Columns)
                Require(column >= 0 && column < coarser, "stencils: column out of range");
            return level;
        }

        static float[] FixedPoint(Reader reader, int frame, int id, int count, string what)
        {
            int table = reader.Table(frame, id);
            Require(table != 0, what);
            float step = reader.GetFloat(table, 0);
            Require(step > 0 && step <= 0.0201f, what);
            return Scaled(reader, reader.Vector(table, 1, 2), count, step, what);
        }

        static float[] Scaled(Reader reader, Reader.Span span, int count, float step, string what)
        {
            Require(span.Count == count, what);
            var integers = new short[count];
            reader.Copy(span, 2, integers);
            var values = new float[count];
            for (int k = 0; k < count; ++k)
                values[k] = integers[k] * step;
            return values;
        }

        static bool IsPose(float[] p)
        {
            for (int i = 0; i < 3; ++i)
                for (int j = 0; j < 3; ++j)
                {
                    float dot = p[4 * i] * p[4 * j] + p[4 * i + 1] * p[4 * j + 1] + p[4 * i + 2] * p[4 * j + 2];
                    if (!(Math.Abs(dot - (i == j ? 1 : 0)) < 1e-2f))
                        return false;
                }
            return p[0] * (p[5] * p[10] - p[6] * p[9]) - p[1] * (p[4] * p[10] - p[6] * p[8]) + p[2] * (p[4] * p[9] - p[5] * p[8]) > 0;
        }
    }

    /// FlatBuffers, as far as these messages need them.
    sealed class Reader
    {
        internal struct Span { internal int At, Count; }

        readonly byte[] bytes;

        internal Reader(byte[] message)
        {
            if (!BitConverter.IsLittleEndian)
                throw new NotSupportedException("facet: numbers are read as they lie in memory: little-endian machines only");
            bytes = message;
            Message.Require(message.Length <= Message.MostBytes, "a message of " + message.Length + " bytes is too long");
            Inside(0, 8);
            Message.Require(Encoding.ASCII.GetString(message, 4, 4) == "FCT1", "it is no message of this version");
        }

        internal int Root() { return Follow(0); }

        /// The table of the message's kind.
        internal int Body(MessageKind kind)
        {
            int root = Root();
            Message.Require(U8(Need(root, 0, 1, "it has no kind")) == (int)kind, "it is of another kind than " + kind);
            int body = Table(root, 1);
            Message.Require(body != 0, "it has no body");
            return body;
        }

        void Inside(long at, long count)
        {
            Message.Require(at >= 0 && count >= 0 && at <= bytes.Length && count <= bytes.Length - at, "its structure is broken, or it is cut off");
        }

        internal int U8(int at) { Inside(at, 1); return bytes[at]; }
        int U16(long at) { Inside(at, 2); return BitConverter.ToUInt16(bytes, (int)at); }
        uint U32(long at) { Inside(at, 4); return BitConverter.ToUInt32(bytes, (int)at); }

        internal float Float(long at)
        {
            Inside(at, 4);
            float value = BitConverter.ToSingle(bytes, (int)at);
            Message.Require(!float.IsNaN(value) && !float.IsInfinity(value), "a number is not finite");
            return value;
        }

        int Follow(long at)
        {
            uint offset = U32(at);
            Message.Require(offset != 0, "its structure is broken");
            Inside(at + offset, 4);
            return (int)(at + offset);
        }

        /// Where field `id` of a table lies; 0: it is not there.
        internal int Field(int table, int id, int size)
        {
            Inside(table, 4);
            long vtable = (long)table - BitConverter.ToInt32(bytes, table);
            int entry = 4 + 2 * id;
            if (entry + 2 > U16(vtable))
                return 0;
            int offset = U16(vtable + entry);
            if (offset == 0)
                return 0;
            Inside((long)table + offset, size);
            return table + offset;
        }

        internal int Need(int table, int id, int size, string what)
        {
            int field = Field(table, id, size);
            Message.Require(field != 0, what);
            return field;
        }

        internal int GetU8(int table, int id) { int at = Field(table, id, 1); return at != 0 ? bytes[at] : 0; }
        internal uint GetU32(int table, int id) { int at = Field(table, id, 4); return at != 0 ? U32(at) : 0; }
        internal ulong GetU64(int table, int id) { int at = Field(table, id, 8); return at != 0 ? BitConverter.ToUInt64(bytes, at) : 0; }
        internal float GetFloat(int table, int id) { int at = Field(table, id, 4); return at != 0 ? Float(at) : 0; }
        internal int Table(int table, int id) { int at = Field(table, id, 4); return at != 0 ? Follow(at) : 0; }

        internal Span Vector(int table, int id, int size)
        {
            int at = Table(table, id);
            if (at == 0)
                return new Span();
            uint count = U32(at);
            Inside((long)at + 4, (long)count * size);
            return new Span { At = at + 4, Count = (int)count };
        }

        internal void Copy(Span span, int size, Array into) { Buffer.BlockCopy(bytes, span.At, into, 0, span.Count * size); }

        internal float[] Floats(int table, int id)
        {
            Span span = Vector(table, id, 4);
            var values = new float[span.Count];
            Copy(span, 4, values);
            foreach (float value in values)
                Message.Require(!float.IsNaN(value) && !float.IsInfinity(value), "a number is not finite");
            return values;
        }

        internal int[] Indices(int table, int id, int most, string what)
        {
            Span span = Vector(table, id, 4);
            Message.Require(span.Count <= most, what);
            var values = new int[span.Count];
            Copy(span, 4, values);
            return values;
        }

        internal int[] Tables(int table, int id, int most, string what)
        {
            Span span = Vector(table, id, 4);
            Message.Require(span.Count <= most, what);
            var values = new int[span.Count];
            for (int k = 0; k < values.Length; ++k)
                values[k] = Follow(span.At + 4 * k);
            return values;
        }

        internal string TextAt(int at, int most)
        {
            uint length = U32(at);
            Message.Require(length <= most, "a text is too long");
            Inside((long)at + 4, length);
            return Encoding.UTF8.GetString(bytes, at + 4, (int)length);
        }

        internal string Text(int table, int id, int most)
        {
            int at = Table(table, id);
            return at != 0 ? TextAt(at, most) : "";
        }
    }

    /// The finest mesh of a frame (docs/stream-protocol.md, "Rebuilding"; [MD19 sec. 4.3]).
    public static class Mesh
    {
        /// Head frame, mm; normals of unit length. Both [subject.VertexCount][3]. False where the frame has no mesh.
        public static bool Rebuild(Frame frame, Subject subject, out float[] verticesMm, out float[] normals)
        {
            verticesMm = frame.VerticesMm;
            normals = frame.Normals;
            if (frame.ControlVerticesMm == null)
                return verticesMm != null;
            verticesMm = frame.ControlVerticesMm;
            foreach (Level level in subject.Levels)
                verticesMm = Apply(level, verticesMm);
            normals = VertexNormals(verticesMm, subject.Triangles);
            if (frame.DisplacementsMm == null)
                return true;
            for (int k = 0; k < verticesMm.Length; ++k)
                verticesMm[k] += normals[k] * frame.DisplacementsMm[k / 3];
            normals = VertexNormals(verticesMm, subject.Triangles);
            return true;
        }

        // out[row] = sum of weights * coarser[column] over the row.
        static float[] Apply(Level level, float[] coarser)
        {
            var finer = new float[3 * level.VertexCount];
            for (int row = 0; row < level.VertexCount; ++row)
                for (int entry = level.RowOffsets[row]; entry < level.RowOffsets[row + 1]; ++entry)
                    for (int k = 0; k < 3; ++k)
                        finer[3 * row + k] += level.Weights[entry] * coarser[3 * level.Columns[entry] + k];
            return finer;
        }

        // Area-weighted.
        static float[] VertexNormals(float[] vertices, int[] triangles)
        {
            var normals = new float[vertices.Length];
            for (int t = 0; t < triangles.Length; t += 3)
            {
                int a = 3 * triangles[t], b = 3 * triangles[t + 1], c = 3 * triangles[t + 2];
                for (int i = 0; i < 3; ++i)
                {
                    int j = (i + 1) % 3, k = (i + 2) % 3;
                    float area = (vertices[b + j] - vertices[a + j]) * (vertices[c + k] - vertices[a + k])
                        - (vertices[b + k] - vertices[a + k]) * (vertices[c + j] - vertices[a + j]);
                    normals[a + i] += area;
                    normals[b + i] += area;
                    normals[c + i] += area;
                }
            }
            for (int v = 0; v < normals.Length; v += 3)
            {
                float length = (float)Math.Sqrt(normals[v] * normals[v] + normals[v + 1] * normals[v + 1] + normals[v + 2] * normals[v + 2]);
                for (int k = 0; k < 3 && length > 0; ++k)
                    normals[v + k] /= length;
            }
            return normals;
        }
    }
}
