// The C# client before two servers: the C++ one, whose frames it must give as the C++ decoder does, and one that says what it may not.
// Usage: CheckClient.exe PATCH-SERVER FOLDER EXPECTED-FOLDER GOLDEN-FOLDER CORPUS-FOLDER ...
// FOLDER is for sockets, EXPECTED-FOLDER is write_expected's, the corpora are those of the stream's fuzzers.
using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Net;
using System.Net.Sockets;
using System.Threading;
using Facet;

static class CheckClient
{
    const int Patience_ms = 100000;  // for what must come; passing never takes it

    static int refused, ended, frames;

    static int Main(string[] arguments)
    {
        CheckServer(arguments[0], arguments[1], arguments[2]);
        using (var server = new ScriptedServer(Path.Combine(arguments[1], "scripted.sock"), Golden(arguments[3], "hello")))
        {
            CheckGolden(server, arguments[3]);
            foreach (string name in new[] { "hello", "subject", "albedo", "frame_displacements", "dropped", "goodbye", "subscribe" })
                CheckBroken(server, Golden(arguments[3], name), Golden(arguments[3], "subject"), 1000);
            CheckCorpus(server, arguments.Skip(4).SelectMany(Directory.GetFiles).OrderBy(name => name, StringComparer.Ordinal).Select(File.ReadAllBytes).ToArray());
        }
        Console.WriteLine("broken messages: " + refused + " refused, " + frames + " frames, " + ended + " ended");
        Check(refused > 10000 && frames > 500, "hardly anything was refused, or read");
        return 0;
    }

    static void Check(bool holds, string what)
    {
        if (!holds)
            throw new Exception(what);
    }

    static void Throws<T>(Action what, string saying) where T : Exception
    {
        try
        {
            what();
        }
        catch (T error)
        {
            Check(error.Message.Contains(saying), error.Message);
            return;
        }
        throw new Exception("no " + typeof(T).Name);
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

    static void CheckServer(string program, string folder, string expected)
    {
        string socket = Path.Combine(folder, "stream.sock");
        using (Process server = Process.Start(new ProcessStartInfo(program, folder) { RedirectStandardInput = true, RedirectStandardOutput = true, UseShellExecute = false }))
        {
            try
            {
                server.StandardOutput.ReadLine();  // it listens
                foreach (Profile profile in new[] { Profile.Signals, Profile.Displacements, Profile.Vertices })
                    foreach (bool ring in new[] { false, true })
                        CheckProfile(socket, profile, ring, expected);
                CheckMisuse(socket, server);
                CheckAnotherSubject(socket, server);
            }
            finally
            {
                server.StandardInput.Close();
                if (!server.WaitForExit(Patience_ms))
                    server.Kill();
            }
        }
        using (var client = new Client(socket))
            Throws<Error>(() => client.Next(1000), "nobody answers");
        Throws<ArgumentException>(() => new Client(new string('x', 200)), "path is too long");
    }

    static void CheckProfile(string socket, Profile profile, bool ring, string folder)
    {
        string name = profile.ToString().ToLowerInvariant();
        using (var client = new Client(socket, profile, true, ring))
        {
            Frame frame = client.Next(Patience_ms);
            Subject subject = client.Subject;
            Check(client.ByRing == ring && ReferenceEquals(subject, client.Subject), "ring, or its subject was copied twice");
            // What the C++ decoder gives, one a line.
            string[] expected = File.ReadAllLines(Path.Combine(folder, "scalars-" + name + ".txt"));
            var has = new[]
            {
                subject.Id.ToString(), string.Join(",", subject.ExpressionNames), subject.VertexCount.ToString(), string.Join(",", subject.Triangles.Take(30)),
                frame.Sequence.ToString(), frame.TimestampNs.ToString(), ((int)frame.State).ToString(), frame.AlbedoVersion.ToString()
            };
            // The server makes subjects of its own: their ids are its.
            for (int k = 1; k < Math.Max(has.Length, expected.Length); ++k)
                Check(has[k] == expected[k], name + ", line " + (k + 1) + ": " + has[k] + " is " + expected[k]);
            Check(frame.SubjectId == subject.Id && frame.LandmarksPx.Length == 2 * 468, "frame's subject, landmarks");
            Check(Apart(frame.Expression, Floats(folder, "expression-" + name + ".f32")) == 0, "expression");
            Check(Apart(frame.CameraFromHead, Floats(folder, "pose-" + name + ".f32")) == 0, "pose");
            float[] vertices_mm, normals;
            bool there = client.Mesh(out vertices_mm, out normals);
            Check(there == (profile != Profile.Signals), "mesh");
            Check(client.Next(0) == null, "a frame came twice");
            if (!there)
                return;
            double apart_mm = Apart(vertices_mm, Floats(folder, "vertices-" + name + ".f32"));
            double turned = Apart(normals, Floats(folder, "normals-" + name + ".f32"));
            Console.WriteLine(string.Format(CultureInfo.InvariantCulture, "{0}{1}: {2} vertices, at most {3:g3} mm and {4:g3} from the C++ decoder's", name, ring ? ", ring" : "", subject.VertexCount, apart_mm, turned));
            Check(apart_mm < 1e-4 && turned < 1e-4, "another mesh");
            Check(Apart(subject.TextureCoordinates, Floats(folder, "coordinates-" + name + ".f32")) == 0, "texture coordinates");
            Albedo albedo = client.Albedo;
            Check(albedo.SubjectId == subject.Id && albedo.Version == frame.AlbedoVersion, "albedo's subject");
            Check(Apart(albedo.LinearRgb, Floats(folder, "albedo-" + name + ".f32")) < 1e-6, "albedo");
        }
    }

    // What was given stays, and nobody frees what another thread is waiting in.
    static void CheckMisuse(string socket, Process server)
    {
        var client = new Client(socket, albedo: true);
        float[] vertices_mm, normals;
        Check(client.Next(Patience_ms) != null && client.Mesh(out vertices_mm, out normals), "a mesh");
        Subject subject = client.Subject;
        var waiting = new Thread(() =>
        {
            while (true)
            {
                try
                {
                    client.Next(-1);
                    return;
                }
                catch (InvalidOperationException)  // the other thread was looking
                {
                }
            }
        });
        waiting.Start();
        while (true)
        {
            try
            {
                client.Next(0);
            }
            catch (InvalidOperationException)
            {
                break;
            }
        }
        Throws<InvalidOperationException>(client.Dispose, "another thread");
        Throws<InvalidOperationException>(() => client.Mesh(out vertices_mm, out normals), "another thread");
        server.StandardInput.WriteLine(9);
        server.StandardInput.Flush();
        waiting.Join();
        client.Dispose();
        client.Dispose();
        Check(subject.Triangles.Max() == subject.VertexCount - 1, "triangles of a client that is gone");
        foreach (Action use in new Action[] { () => client.Next(0), () => client.Mesh(out vertices_mm, out normals), () => Check(client.Subject == null, ""), () => Check(client.Albedo == null, "") })
            Throws<ObjectDisposedException>(use, "Facet.Client");
    }

    // Another mesh under the id that was there.
    static void CheckAnotherSubject(string socket, Process server)
    {
        using (var client = new Client(socket))
        {
            Check(client.Next(Patience_ms) != null, "a frame");
            Subject before = client.Subject;
            server.StandardInput.WriteLine(5);
            server.StandardInput.Flush();
            Frame frame = client.Next(Patience_ms);
            float[] vertices_mm, normals;
            Check(client.Mesh(out vertices_mm, out normals) && frame.SubjectId == client.Subject.Id, "another mesh");
            Check(!ReferenceEquals(before, client.Subject) && vertices_mm.Length == 3 * client.Subject.VertexCount && client.Subject.VertexCount < before.VertexCount, "its subject");
        }
    }

    static byte[] Golden(string folder, string name) { return File.ReadAllBytes(Path.Combine(folder, "v1_" + name + ".bin")); }

    // What tests/stream/test_golden.cpp put into them.
    static void CheckGolden(ScriptedServer server, string folder)
    {
        server.Say(Golden(folder, "subject"), Golden(folder, "albedo"), Golden(folder, "frame_displacements"), Golden(folder, "goodbye"));
        using (var client = new Client(server.Socket, Profile.Displacements, true))
        {
            Frame frame = client.Next(Patience_ms);
            Subject subject = client.Subject;
            Check(subject.Id == 42 && subject.ExpressionNames.SequenceEqual(new[] { "jawOpen", "mouthPucker" }) && subject.Identity.SequenceEqual(new[] { 0.5f, -2.0f }), "golden subject");
            Check(subject.Triangles.SequenceEqual(new[] { 0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4 }), "golden triangles");
            Check(frame.Sequence == 77 && frame.TimestampNs == 123456789012 && frame.State == TrackingState.Tracking && frame.DegradedReason == "test", "golden frame");
            Check(frame.CameraFromHead.SequenceEqual(new float[] { 1, 0, 0, 8, 0, -1, 0, -16, 0, 0, -1, 512 }), "golden pose");
            Check(frame.Expression.SequenceEqual(new[] { 0.25f, 0.5f }), "golden expression");
            Albedo albedo = client.Albedo;
            Check(albedo.Version == 2 && Apart(albedo.LinearRgb, new[] { 0, 0, 0, 1, 1, 1, 0.5f, 0.25f, 0.125f, 0.75f, 0.5f, 0.25f, 1, 0.5f, 0 }) < 1e-4, "golden albedo");
            float[] vertices_mm, normals;
            Check(client.Mesh(out vertices_mm, out normals) && vertices_mm.Length == 15 && normals.All(value => Math.Abs(value) <= 1.0001f), "golden mesh");
            Throws<Error>(() => { for (int k = 0; k < 2; ++k) client.Next(Patience_ms); }, "the server stops");
        }
    }

    // Whatever is broken is an Error; everything else ends the test. Whoever is given a frame can read all of it.
    static void Try(ScriptedServer server, params byte[][] messages)
    {
        server.Say(messages);
        using (var client = new Client(server.Socket, Profile.Displacements, true))
        {
            try
            {
                for (Frame frame; (frame = client.Next(Patience_ms)) != null; ++frames)
                {
                    float[] vertices_mm, normals;
                    if (frame.SubjectId == 0)
                        continue;
                    Subject subject = client.Subject;
                    Check(subject.Id == frame.SubjectId && frame.Expression.Length == subject.ExpressionNames.Length && frame.CameraFromHead.Length == 12, "a frame without its subject");
                    Check(subject.Triangles.All(vertex => vertex >= 0 && vertex < subject.VertexCount), "a triangle names a vertex that is not there");
                    if (client.Mesh(out vertices_mm, out normals))
                        Check(vertices_mm.Length == 3 * subject.VertexCount && normals.Length == vertices_mm.Length, "a mesh of another size");
                    Albedo albedo = client.Albedo;
                    Check(albedo == null || albedo.LinearRgb.Length % 3 == 0, "albedo");
                }
                throw new Exception("the server's end was not told");
            }
            catch (Error error)
            {
                Check(error.Outcome == Outcome.BadData || error.Outcome == Outcome.Closed, error.Outcome + ": " + error.Message);
                refused += error.Outcome == Outcome.BadData ? 1 : 0;
                ended += error.Outcome == Outcome.Closed ? 1 : 0;
            }
        }
    }

    static void CheckBroken(ScriptedServer server, byte[] whole, byte[] subject, int changes)
    {
        for (int length = 0; length < whole.Length - 8; length += Math.Max(1, whole.Length / 60))
            Try(server, subject, whole.Take(length).ToArray());
        var random = new Random(1);
        for (int k = 0; k < changes; ++k)
        {
            var changed = (byte[])whole.Clone();
            for (int n = random.Next(1, 4); n > 0; --n)
                changed[random.Next(changed.Length)] = (byte)random.Next(256);
            Try(server, subject, changed);
        }
        // Numbers and offsets as large as they get, at each aligned place of the front.
        for (int at = 8; at + 4 <= Math.Min(whole.Length, 200); at += 4)
            foreach (uint value in new[] { 0xFFFFFFFFu, 0x80000000u })
            {
                var changed = (byte[])whole.Clone();
                BitConverter.GetBytes(value).CopyTo(changed, at);
                Try(server, subject, changed);
            }
    }

    // What the fuzzers of the C and C++ decoders found worth keeping: each behind each, so that frames find their subjects; changed, and spliced.
    static void CheckCorpus(ScriptedServer server, byte[][] messages)
    {
        Check(messages.Length >= 20, "the corpora are not there");
        var random = new Random(2);
        foreach (byte[] message in messages)
            foreach (byte[] before in messages)
            {
                Try(server, before, message);
                for (int k = 0; k < 5; ++k)
                {
                    byte[] other = messages[random.Next(messages.Length)];
                    int at = random.Next(Math.Min(message.Length, other.Length)) & ~3;
                    Try(server, before, message.Take(at).Concat(other.Skip(at)).ToArray());
                    var changed = (byte[])message.Clone();
                    changed[random.Next(changed.Length)] = (byte)random.Next(256);
                    Try(server, before, changed);
                }
            }
    }

    /// Says hello, reads what the client wants, says what it is told to say and nothing more, to one client after another.
    sealed class ScriptedServer : IDisposable
    {
        public readonly string Socket;
        readonly Socket listening = new Socket(AddressFamily.Unix, SocketType.Stream, ProtocolType.Unspecified);
        readonly byte[] hello;
        byte[][] messages = new byte[0][];

        public ScriptedServer(string path, byte[] helloMessage)
        {
            Socket = path;
            hello = helloMessage;
            listening.Bind(new UnixPath(path));
            listening.Listen(8);
            new Thread(Serve) { IsBackground = true }.Start();
        }

        /// To the clients that connect from now on.
        public void Say(params byte[][] what) { Volatile.Write(ref messages, what); }

        public void Dispose() { listening.Close(); }

        void Serve()
        {
            var buffer = new byte[1 << 12];
            while (true)
            {
                Socket client;
                try
                {
                    client = listening.Accept();
                }
                catch (Exception)
                {
                    return;  // disposed
                }
                using (client)
                    try
                    {
                        Send(client, hello);
                        if (client.Receive(buffer) == 0)
                            continue;
                        foreach (byte[] message in Volatile.Read(ref messages))
                            Send(client, message);
                        client.Shutdown(SocketShutdown.Send);
                        while (client.Receive(buffer) > 0)
                        {
                        }
                    }
                    catch (SocketException)  // the client has had enough
                    {
                    }
            }
        }

        static void Send(Socket client, byte[] message)
        {
            var framed = new List<byte> { (byte)'F', (byte)'C', (byte)'T', (byte)'M' };
            framed.AddRange(BitConverter.GetBytes(message.Length));
            framed.AddRange(message);
            client.Send(framed.ToArray());
        }
    }

    /// A socket's path as the kernel reads it.
    sealed class UnixPath : EndPoint
    {
        readonly string path;
        public UnixPath(string given) { path = given; }
        public override AddressFamily AddressFamily { get { return AddressFamily.Unix; } }
        public override EndPoint Create(SocketAddress address) { return new UnixPath(""); }
        public override SocketAddress Serialize()
        {
            var address = new SocketAddress(AddressFamily.Unix, 2 + path.Length + 1);
            for (int k = 0; k < path.Length; ++k)
                address[2 + k] = (byte)path[k];
            address[2 + path.Length] = 0;
            return address;
        }
    }
}
