// A live face in Unity: put FacetClient.cs and this file into Assets/ and libfacet-client.so into Assets/Plugins/, add the component
// FacetFace to an object with a MeshFilter and a MeshRenderer. Reads the socket of a facetd on this machine on a thread of its own,
// connecting again by itself. Linux, as the library is.

using System;
using System.Collections.Generic;
using System.Threading;
using UnityEngine;

[RequireComponent(typeof(MeshFilter), typeof(MeshRenderer))]
public sealed class FacetFace : MonoBehaviour
{
    public string socket = Facet.Client.DefaultSocket;
    [Tooltip("Displacements: compact, rebuilt by the library. Vertices: about four times the bytes, nothing to rebuild.")]
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

    Thread reader;
    volatile bool ending;
    Shown newest;
    string said = "connecting";
    Mesh mesh;
    ulong subjectShown;
    // The reading thread's: what the colours are of.
    Facet.Subject coloured;
    ulong colouredVersion;
    Color[] colours;
    readonly Dictionary<string, int> shapes = new Dictionary<string, int>();

    void OnEnable()
    {
        mesh = new Mesh { indexFormat = UnityEngine.Rendering.IndexFormat.UInt32 };
        mesh.MarkDynamic();
        GetComponent<MeshFilter>().sharedMesh = mesh;
        for (int k = 0; rig != null && k < rig.sharedMesh.blendShapeCount; ++k)
            shapes[Plain(rig.sharedMesh.GetBlendShapeName(k))] = k;
        subjectShown = 0;
        newest = null;
        ending = false;
        reader = new Thread(Read) { IsBackground = true, Name = "facet" };
        reader.Start();
    }

    // The editor unloads scripts when it stops or compiles: no thread may be inside the library then, and no client be left behind.
    void OnDisable()
    {
        ending = true;
        reader.Join();
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
        for (int k = 0; k < shown.frame.AvatarValues.Length; ++k)
        {
            int shape;
            if (shapes.TryGetValue(Plain(shown.subject.ExpressionNames[k]), out shape))
                rig.SetBlendShapeWeight(shape, 100.0f * Mathf.Clamp01(shown.frame.AvatarValues[k]));
        }
    }

    // The reading thread, to which the client belongs alone. Looks every Patience_ms whether it is to end.
    void Read()
    {
        const int Patience_ms = 100;
        while (!ending)
        {
            try
            {
                // No ring: what Unity shows is copied in any case, and the socket can't be overtaken.
                using (var client = new Facet.Client(socket, profile, true, false, true, "unity"))
                    while (!ending)
                        Show(client, client.Next(Patience_ms));
            }
            catch (Exception error)  // a message that breaks the protocol, or the library is not there
            {
                Volatile.Write(ref said, error.Message);
                for (int wait_ms = 0; wait_ms < 1000 && !ending; wait_ms += Patience_ms)
                    Thread.Sleep(Patience_ms);
            }
        }
    }

    void Show(Facet.Client client, Facet.Frame frame)
    {
        if (frame == null)
            return;
        Volatile.Write(ref said, frame.State + ", frame " + frame.Sequence);
        float[] vertices_mm, normals;
        if (frame.SubjectId == 0 || !client.Mesh(out vertices_mm, out normals))
            return;
        Facet.Subject subject = client.Subject;
        if (!ReferenceEquals(subject, coloured) || frame.AlbedoVersion != colouredVersion)
        {
            Facet.Albedo albedo = frame.AlbedoVersion != 0 ? client.Albedo : null;
            bool fits = albedo != null && albedo.SubjectId == subject.Id && albedo.LinearRgb.Length == 3 * subject.VertexCount;
            colours = fits ? Colours(albedo) : null;
            coloured = subject;
            colouredVersion = fits ? frame.AlbedoVersion : 0;
        }
        Interlocked.Exchange(ref newest, new Shown
        {
            subject = subject, frame = frame, colours = colours,
            vertices = Points(vertices_mm, 0.001f), normals = Points(normals, 1.0f)
        });
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
