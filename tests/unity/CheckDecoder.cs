// The C# decoder against the C++ one: what write_messages wrote, the golden messages, and bytes that are broken.
// Usage: CheckDecoder.exe MESSAGES-FOLDER GOLDEN-FOLDER CORPUS-FOLDER ...      The corpora are those of the stream's fuzzers.
using System;
using System.Globalization;
using System.IO;
using System.Linq;
using Facet;

static class CheckDecoder
{
    static int refused, read;

    static int Main(string[] arguments)
    {
        foreach (string profile in new[] { "signals", "displacements", "vertices" })
            CheckProfile(arguments[0], profile);
        CheckGolden(arguments[1]);
        CheckOversize();
        foreach (string name in new[] { "hello", "subject", "albedo", "frame_displacements", "dropped", "goodbye", "subscribe" })
            CheckBroken(File.ReadAllBytes(Path.Combine(arguments[1], "v1_" + name + ".bin")), Message.ReadSubject(Golden(arguments[1], "subject")), 3000);
        foreach (string profile in new[] { "displacements", "vertices" })
            foreach (string kind in new[] { "subject", "frame", "albedo" })
                CheckBroken(File.ReadAllBytes(Path.Combine(arguments[0], kind + "-" + profile + ".bin")),
                    Message.ReadSubject(File.ReadAllBytes(Path.Combine(arguments[0], "subject-" + profile + ".bin"))), 600);
        CheckCorpus(arguments.Skip(2).SelectMany(Directory.GetFiles).OrderBy(name => name, StringComparer.Ordinal).Select(File.ReadAllBytes).ToArray());
        Console.WriteLine("broken messages: " + refused + " refused, " + read + " read");
        Check(refused > 10000, "hardly anything was refused");
        return 0;
    }

    static void Check(bool holds, string what)
    {
        if (!holds)
            throw new Exception(what);
    }

    static float[] Floats(string folder, string name)
    {
        byte[] bytes = File.ReadAllBytes(Path.Combine(folder, name));
        var values = new float[bytes.Length / 4];
        Buffer.BlockCopy(bytes, 0, values, 0, bytes.Length);
        return values;
    }

    static double Apart(float[] a, float[] b)
    {
        Check(a.Length == b.Length && a.Length > 0, a.Length + " and " + b.Length + " numbers");
        return a.Zip(b, (x, y) => (double)Math.Abs(x - y)).Max();
    }

    static void CheckProfile(string folder, string profile)
    {
        Func<string, byte[]> message = kind => File.ReadAllBytes(Path.Combine(folder, kind + "-" + profile + ".bin"));
        Subject subject = Message.ReadSubject(message("subject"));
        Check(Message.KindOf(message("frame")) == MessageKind.Frame && Message.SubjectOfFrame(message("frame")) == subject.Id, "frame's subject");
        Frame frame = Message.ReadFrame(message("frame"), subject);
        // What the C++ decoder gives, one a line.
        string[] expected = File.ReadAllLines(Path.Combine(folder, "scalars-" + profile + ".txt"));
        var has = new[]
        {
            subject.Id.ToString(), string.Join(",", subject.ExpressionNames), subject.ControlVertexCount.ToString(), subject.VertexCount.ToString(),
            string.Join(",", subject.Triangles.Take(30)), frame.Sequence.ToString(), frame.TimestampNs.ToString(), ((int)frame.State).ToString(),
            frame.AlbedoVersion.ToString()
        };
        for (int k = 0; k < Math.Max(has.Length, expected.Length); ++k)
            Check(has[k] == expected[k], profile + ", line " + (k + 1) + ": " + has[k] + " is " + expected[k]);
        Check(Apart(frame.Expression, Floats(folder, "expression-" + profile + ".f32")) == 0, "expression");
        Check(Apart(frame.CameraFromHead, Floats(folder, "pose-" + profile + ".f32")) == 0, "pose");
        float[] vertices_mm, normals;
        bool there = Mesh.Rebuild(frame, subject, out vertices_mm, out normals);
        Check(there == (profile != "signals"), "mesh");
        if (!there)
            return;
        double apart_mm = Apart(vertices_mm, Floats(folder, "vertices-" + profile + ".f32"));
        double turned = Apart(normals, Floats(folder, "normals-" + profile + ".f32"));
        Console.WriteLine(string.Format(CultureInfo.InvariantCulture, "{0}: {1} vertices, at most {2:g3} mm and {3:g3} from the C++ decoder's", profile, subject.VertexCount, apart_mm, turned));
        Check(apart_mm < 1e-4 && turned < 1e-4, "another mesh");
        Check(Apart(subject.TextureCoordinates, Floats(folder, "coordinates-" + profile + ".f32")) == 0, "texture coordinates");
        Albedo albedo = Message.ReadAlbedo(message("albedo"));
        Check(albedo.SubjectId == subject.Id && albedo.Version == frame.AlbedoVersion, "albedo's subject");
        Check(Apart(albedo.LinearRgb, Floats(folder, "albedo-" + profile + ".f32")) < 1e-6, "albedo");
    }

    static byte[] Golden(string folder, string name) { return File.ReadAllBytes(Path.Combine(folder, "v1_" + name + ".bin")); }

    // What tests/stream/test_golden.cpp put into them.
    static void CheckGolden(string folder)
    {
        Check(Message.ReadHello(Golden(folder, "hello")) == Message.ProtocolVersion, "hello");
        Subject subject = Message.ReadSubject(Golden(folder, "subject"));
        Check(subject.Id == 42 && subject.ExpressionNames.SequenceEqual(new[] { "jawOpen", "mouthPucker" }) && subject.Identity.SequenceEqual(new[] { 0.5f, -2.0f }), "golden subject");
        Check(subject.Triangles.SequenceEqual(new[] { 0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4 }), "golden triangles");
        Frame frame = Message.ReadFrame(Golden(folder, "frame_displacements"), subject);
        Check(frame.Sequence == 77 && frame.TimestampNs == 123456789012 && frame.State == TrackingState.Tracking && frame.DegradedReason == "test", "golden frame");
        Check(frame.CameraFromHead.SequenceEqual(new float[] { 1, 0, 0, 8, 0, -1, 0, -16, 0, 0, -1, 512 }), "golden pose");
        Check(frame.Expression.SequenceEqual(new[] { 0.25f, 0.5f }), "golden expression");
        Check(Apart(frame.ControlVerticesMm, new float[] { -10, -10, 0, 10, -10, 1, 10, 10, 2, -10, 10, 3 }) < 0.01, "golden control vertices");
        Check(Apart(frame.DisplacementsMm, new[] { 0, 0.25f, -0.5f, 1, 2 }) < 0.001, "golden displacements");
        Albedo albedo = Message.ReadAlbedo(Golden(folder, "albedo"));
        Check(albedo.Version == 2 && Apart(albedo.LinearRgb, new[] { 0, 0, 0, 1, 1, 1, 0.5f, 0.25f, 0.125f, 0.75f, 0.5f, 0.25f, 1, 0.5f, 0 }) < 1e-4, "golden albedo");
        Check(Message.ReadGoodbye(Golden(folder, "goodbye")).Length > 0, "golden goodbye");
        byte[] subscribe = Message.Subscribe(Profile.Vertices, true, "test");
        Check(Message.KindOf(subscribe) == MessageKind.Subscribe, "subscribe");
        File.WriteAllBytes("subscribe.bin", subscribe);  // read_subscribe looks at it
    }

    static void CheckOversize()
    {
        try
        {
            Message.KindOf(new byte[Message.MostBytes + 1]);
        }
        catch (Facet.FormatException error)
        {
            Check(error.Message.Contains("too long"), error.Message);
            return;
        }
        throw new Exception("a message that is too long was read");
    }

    // Whatever is broken is a FormatException; everything else ends the test.
    static void Try(byte[] message, Subject subject)
    {
        try
        {
            switch (Message.KindOf(message))
            {
                case MessageKind.Hello: Message.ReadHello(message); break;
                case MessageKind.Dropped: Message.ReadDropped(message); break;
                case MessageKind.Goodbye: Message.ReadGoodbye(message); break;
                case MessageKind.Subject: Message.ReadSubject(message); break;
                case MessageKind.Albedo: Message.ReadAlbedo(message); break;
                case MessageKind.Frame:
                    float[] vertices, normals;
                    Frame frame = Message.ReadFrame(message, subject);
                    if (frame.SubjectId != 0)
                        Mesh.Rebuild(frame, subject, out vertices, out normals);
                    break;
            }
            ++read;
        }
        catch (Facet.FormatException)
        {
            ++refused;
        }
    }

    // What the fuzzers of the C and C++ decoders found worth keeping: each against every subject there is, changed, and spliced with each other.
    static void CheckCorpus(byte[][] messages)
    {
        Check(messages.Length >= 20, "the corpora are not there");
        var subjects = new System.Collections.Generic.List<Subject>();
        foreach (byte[] message in messages)
        {
            try
            {
                subjects.Add(Message.ReadSubject(message));
            }
            catch (Facet.FormatException)
            {
            }
        }
        Check(subjects.Count >= 6, "the corpora have few subjects");
        var random = new Random(2);
        foreach (byte[] message in messages)
            foreach (Subject subject in subjects)
            {
                Try(message, subject);
                for (int k = 0; k < 40; ++k)
                {
                    byte[] other = messages[random.Next(messages.Length)];
                    int at = random.Next(Math.Min(message.Length, other.Length)) & ~3;
                    Try(message.Take(at).Concat(other.Skip(at)).ToArray(), subject);
                    var changed = (byte[])message.Clone();
                    changed[random.Next(changed.Length)] = (byte)random.Next(256);
                    Try(changed, subject);
                }
            }
    }

    static void CheckBroken(byte[] whole, Subject subject, int changes)
    {
        int before = refused;
        Try(whole, subject);
        Check(refused == before, "a message that is whole was refused");
        int step = Math.Max(1, whole.Length / 1000);
        for (int length = 0; length < whole.Length - 8; length += step)
        {
            int had = read;
            Try(whole.Take(length).ToArray(), subject);
            Check(length >= 8 || read == had, "a message of " + length + " bytes was read");
        }
        var random = new Random(1);
        for (int k = 0; k < changes; ++k)
        {
            var changed = (byte[])whole.Clone();
            for (int n = random.Next(1, 4); n > 0; --n)
                changed[random.Next(k % 2 == 0 ? changed.Length : Math.Min(changed.Length, 300))] = (byte)random.Next(256);
            Try(changed, subject);
        }
        // Numbers and offsets as large as they get, at each aligned place of the front.
        for (int at = 8; at + 4 <= Math.Min(whole.Length, 400); at += 4)
            foreach (uint value in new[] { 0xFFFFFFFFu, 0x7FFFFFFFu, 0x80000000u, 0xFFFFFFu })
            {
                var changed = (byte[])whole.Clone();
                BitConverter.GetBytes(value).CopyTo(changed, at);
                Try(changed, subject);
            }
    }
}
