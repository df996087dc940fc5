// A live face in Unity: put FacetMessage.cs and this file into Assets/, add the component FacetFace to an object with a MeshFilter and
// a MeshRenderer. Reads the WebSocket of a running facetd (docs/web.md) on a thread of its own, connecting again by itself.

using System;
using System.Collections.Generic;
using System.Net.WebSockets;
using System.Threading;
using System.Threading.Tasks;
using UnityEngine;

[RequireComponent(typeof(MeshFilter), typeof(MeshRenderer))]
public sealed class FacetFace : MonoBehaviour
{
    public string url = "ws://127.0.0.1:8420/stream";
    [Tooltip("Displacements: compact, rebuilt here. Vertices: about four times the bytes, nothing to rebuild.")]
    public Facet.Profile profile = Facet.Profile.Displacements;
    [Tooltip("An avatar with ARKit's blend shapes that the expression drives; may be empty.")]
    public SkinnedMeshRenderer rig;
    public string state = "connecting";

    // What the reading thread hands to Update: the newest alone.
    sealed class Shown
    {
        public Facet.Subject subject;
        public Facet.Frame frame;
        public Vector3[] vertices, normals;
        public Color[] colours;  // null: as they were
    }

    readonly CancellationTokenSource ending = new CancellationTokenSource();
    Shown newest;
    string said = "connecting";
    Mesh mesh;
    ulong subjectShown;
    readonly Dictionary<string, int> shapes = new Dictionary<string, int>();

    void Start()
    {
        mesh = new Mesh { indexFormat = UnityEngine.Rendering.IndexFormat.UInt32 };
        mesh.MarkDynamic();
        GetComponent<MeshFilter>().sharedMesh = mesh;
        for (int k = 0; rig != null && k < rig.sharedMesh.blendShapeCount; ++k)
            shapes[Plain(rig.sharedMesh.GetBlendShapeName(k))] = k;
        Task.Run(() => Read(ending.Token));
    }

    void OnDestroy()
    {
        ending.Cancel();
    }

    void Update()
    {
        state = Volatile.Read(ref said);
        Shown shown = Interlocked.Exchange(ref newest, null);
        if (shown == null)
            return;
        if (shown.subject.Id != subjectShown)
        {
            mesh.Clear();
            mesh.vertices = shown.vertices;
            mesh.uv = TextureCoordinates(shown.subject);
            mesh.triangles = Clockwise(shown.subject.Triangles);
            subjectShown = shown.subject.Id;
        }
        mesh.vertices = shown.vertices;
        mesh.normals = shown.normals;
        if (shown.colours != null)
            mesh.colors = shown.colours;
        mesh.RecalculateBounds();
        transform.localRotation = Turn(shown.frame.CameraFromHead);
        for (int k = 0; k < shown.frame.Expression.Length; ++k)
        {
            int shape;
            if (shapes.TryGetValue(Plain(shown.subject.ExpressionNames[k]), out shape))
                rig.SetBlendShapeWeight(shape, 100.0f * Mathf.Clamp01(shown.frame.Expression[k]));
        }
    }

    // The reading thread.
    async Task Read(CancellationToken end)
    {
        int wait_ms = 250;
        while (!end.IsCancellationRequested)
        {
            try
            {
                using (var socket = new ClientWebSocket())
                {
                    socket.Options.AddSubProtocol("facet");
                    await socket.ConnectAsync(new Uri(url), end);
                    await socket.SendAsync(new ArraySegment<byte>(Facet.Message.Subscribe(profile, true, "unity")), WebSocketMessageType.Binary, true, end);
                    wait_ms = 250;
                    await ReadMessages(socket, end);
                }
            }
            catch (OperationCanceledException)
            {
                return;
            }
            catch (Exception error)  // the network, or a message that breaks the protocol
            {
                Volatile.Write(ref said, error.Message);
            }
            await Task.Delay(wait_ms).ConfigureAwait(false);
            wait_ms = Math.Min(2 * wait_ms, 3000);
        }
    }

    async Task ReadMessages(ClientWebSocket socket, CancellationToken end)
    {
        var buffer = new byte[1 << 16];
        Facet.Subject subject = null;
        Facet.Albedo albedo = null;
        Color[] colours = null;
        while (true)
        {
            int length = 0;
            WebSocketReceiveResult part;
            do
            {
                if (length == buffer.Length)
                {
                    if (buffer.Length >= Facet.Message.MostBytes)
                        throw new Facet.FormatException("a message is too long");
                    Array.Resize(ref buffer, 2 * buffer.Length);
                }
                part = await socket.ReceiveAsync(new ArraySegment<byte>(buffer, length, buffer.Length - length), end).ConfigureAwait(false);
                length += part.Count;
            } while (!part.EndOfMessage);
            if (part.MessageType == WebSocketMessageType.Close)
                throw new Facet.FormatException("closed: " + socket.CloseStatusDescription);
            var message = new byte[length];
            Array.Copy(buffer, message, length);
            switch (Facet.Message.KindOf(message))
            {
                case Facet.MessageKind.Hello:
                    if (Facet.Message.ReadHello(message) != Facet.Message.ProtocolVersion)
                        throw new Facet.FormatException("the server speaks another version");
                    break;
                case Facet.MessageKind.Goodbye:
                    throw new Facet.FormatException("goodbye: " + Facet.Message.ReadGoodbye(message));
                case Facet.MessageKind.Subject:
                    subject = Facet.Message.ReadSubject(message);
                    break;
                case Facet.MessageKind.Albedo:
                    albedo = Facet.Message.ReadAlbedo(message);
                    colours = null;
                    break;
                case Facet.MessageKind.Frame:
                    Facet.Frame frame = Facet.Message.ReadFrame(message, subject);
                    Volatile.Write(ref said, frame.State + ", frame " + frame.Sequence);
                    float[] vertices_mm, normals;
                    if (frame.SubjectId == 0 || !Facet.Mesh.Rebuild(frame, subject, out vertices_mm, out normals))
                        break;
                    if (colours == null && albedo != null && albedo.SubjectId == subject.Id && albedo.LinearRgb.Length == 3 * subject.VertexCount)
                        colours = Colours(albedo);
                    Interlocked.Exchange(ref newest, new Shown
                    {
                        subject = subject, frame = frame, colours = colours,
                        vertices = Points(vertices_mm, 0.001f), normals = Points(normals, 1.0f)
                    });
                    break;
            }
        }
    }

    // Unity is left-handed: x to the subject's right, y up, z out of the face; metres.
    static Vector3[] Points(float[] numbers, float scale)
    {
        var points = new Vector3[numbers.Length / 3];
        for (int k = 0; k < points.Length; ++k)
            points[k] = new Vector3(-scale * numbers[3 * k], scale * numbers[3 * k + 1], scale * numbers[3 * k + 2]);
        return points;
    }

    // The stream's triangles are counter-clockwise from outside, Unity shows those that are clockwise.
    static int[] Clockwise(int[] triangles)
    {
        var turned = (int[])triangles.Clone();
        for (int k = 0; k < turned.Length; k += 3)
        {
            turned[k + 1] = triangles[k + 2];
            turned[k + 2] = triangles[k + 1];
        }
        return turned;
    }

    static Vector2[] TextureCoordinates(Facet.Subject subject)
    {
        var coordinates = new Vector2[subject.VertexCount];
        for (int k = 0; k < coordinates.Length; ++k)
            coordinates[k] = new Vector2(subject.TextureCoordinates[2 * k], subject.TextureCoordinates[2 * k + 1]);
        return coordinates;
    }

    // Linear values, for a material that multiplies with vertex colours in a project with linear colours.
    static Color[] Colours(Facet.Albedo albedo)
    {
        var colours = new Color[albedo.LinearRgb.Length / 3];
        for (int k = 0; k < colours.Length; ++k)
            colours[k] = new Color(albedo.LinearRgb[3 * k], albedo.LinearRgb[3 * k + 1], albedo.LinearRgb[3 * k + 2], 1.0f);
        return colours;
    }

    // The head's turn before a Unity camera that looks along z (x right, y up) as the real one: y of the camera's axes is turned round.
    static Quaternion Turn(float[] p)
    {
        var up = new Vector3(p[1], -p[5], p[9]);
        var out_of_face = new Vector3(p[2], -p[6], p[10]);
        return Quaternion.LookRotation(out_of_face, up);
    }

    // "eyeBlink_L", "EyeBlinkLeft" and "eyeBlinkLeft" are one shape.
    static string Plain(string name)
    {
        if (name.EndsWith("_L", StringComparison.Ordinal))
            name = name.Substring(0, name.Length - 2) + "Left";
        else if (name.EndsWith("_R", StringComparison.Ordinal))
            name = name.Substring(0, name.Length - 2) + "Right";
        return name.Substring(name.LastIndexOf('.') + 1).Replace("_", "").ToLowerInvariant();
    }
}
