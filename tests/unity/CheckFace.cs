// The component FacetFace before a running server, without Unity: what lands in its mesh and on its rig.
// Usage: CheckFace.exe PATCH-SERVER FOLDER      the server of tests/client/patch_server.cpp; a folder for its sockets
//        CheckFace.exe live SOCKET               a facetd that sees a face: ten pictures of it
using System;
using System.Diagnostics;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Threading;
using UnityEngine;

static class CheckFace
{
    const int Patience_ms = 100000;  // for what must come; passing never takes it

    static int Main(string[] arguments)
    {
        if (arguments[0] == "live")
            return Live(arguments[1]);
        var start = new ProcessStartInfo(arguments[0], arguments[1]) { RedirectStandardInput = true, RedirectStandardOutput = true, UseShellExecute = false };
        using (Process server = Process.Start(start))
        {
            try
            {
                server.StandardOutput.ReadLine();  // it listens
                foreach (Facet.Profile profile in new[] { Facet.Profile.Displacements, Facet.Profile.Vertices })
                    Check(server, Path.Combine(arguments[1], "stream.sock"), profile);
            }
            finally
            {
                server.StandardInput.Close();
                if (!server.WaitForExit(Patience_ms))
                    server.Kill();
            }
        }
        return 0;
    }

    static void Require(bool holds, string what)
    {
        if (!holds)
            throw new Exception(what);
    }

    // What Unity calls by its name.
    static void Call(FacetFace face, string message)
    {
        try
        {
            typeof(FacetFace).GetMethod(message, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(face, null);
        }
        catch (TargetInvocationException error)
        {
            throw new Exception(message + ": " + error.InnerException);
        }
    }

    static FacetFace Begin(string socket, Facet.Profile profile)
    {
        var face = new FacetFace { socket = socket, profile = profile, rig = new SkinnedMeshRenderer { sharedMesh = new UnityEngine.Mesh { shapes = new[] { "nothing", "face.JawOpen", "eyeBlink_L" } } } };
        Call(face, "OnEnable");
        return face;
    }

    // Pictures until `holds`.
    static void Until(FacetFace face, string what, Func<bool> holds)
    {
        for (var patience = Stopwatch.StartNew(); patience.ElapsedMilliseconds < Patience_ms; Thread.Sleep(5))
        {
            Call(face, "Update");
            if (holds())
                return;
        }
        throw new Exception("not in time: " + what + " (" + face.state + ")");
    }

    static void Check(Process server, string socket, Facet.Profile profile)
    {
        FacetFace face = Begin(socket, profile);
        UnityEngine.Mesh mesh = face.GetComponent<MeshFilter>().sharedMesh;
        Until(face, "a first face", () => mesh.vertices.Length > 0);
        int first = mesh.vertices.Length, triangles = mesh.triangles.Length;
        // The patch: 150 mm wide, 60 mm before the head's origin in its middle; metres, and Unity's x.
        Require(Math.Abs(mesh.vertices.Max(point => point.x) - 0.075) < 0.005 && Math.Abs(mesh.vertices.Min(point => point.x) + 0.075) < 0.005, "it is not 150 mm wide");
        Require(Math.Abs(mesh.vertices.Max(point => point.z) - 0.06) < 0.005, "it is not 60 mm before the origin");
        Require(mesh.colors.Length == first && mesh.normals.Length == first && mesh.uv.Length == first && triangles > first, "arrays");
        Require(Math.Abs(mesh.colors[0].r - 0.25) < 1e-3, "albedo");
        double outside = mesh.normals.Average(normal => normal.z);
        Require(outside > 0.6, "normals look into the head: " + outside);
        Require(Faces(mesh) > 0.8, "triangles are not clockwise from outside: " + Faces(mesh));
        // Unity's camera looks along z: the person looks back, upright.
        Quaternion turn = face.transform.localRotation;
        Require(turn.forward.z < -0.9 && turn.up.y > 0.9, "the head is turned");
        Require(face.rig.weights.Count == 2 && face.rig.weights.ContainsKey(1) && face.rig.weights.Values.All(weight => weight >= 0 && weight <= 100), "the rig's shapes");
        // Another mesh under the id that was there, smaller and then as large again.
        foreach (int side in new[] { 5, 9 })
        {
            int shown = mesh.vertices.Length;
            server.StandardInput.WriteLine(side);
            server.StandardInput.Flush();
            Until(face, "another face", () => mesh.vertices.Length != shown);
            Require((mesh.vertices.Length == first) == (side == 9) && (mesh.triangles.Length == triangles) == (side == 9), "its triangles are those of the one before");
            Require(mesh.triangles.Max() == mesh.vertices.Length - 1 && mesh.uv.Length == mesh.vertices.Length, "its arrays");
        }
        Console.WriteLine(profile + ": " + first + " vertices, " + face.state);
        Call(face, "OnDisable");
    }

    // The share of triangles that are clockwise as seen from before the face. Unity's z there points at who looks, x to the right.
    static double Faces(UnityEngine.Mesh mesh)
    {
        int clockwise = 0;
        for (int k = 0; k < mesh.triangles.Length; k += 3)
        {
            Vector3 a = mesh.vertices[mesh.triangles[k]], b = mesh.vertices[mesh.triangles[k + 1]], c = mesh.vertices[mesh.triangles[k + 2]];
            // Left-handed: (b - a) x (c - a) of a clockwise triangle points to the viewer.
            clockwise += (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x) > 0 ? 1 : 0;
        }
        return 3.0 * clockwise / mesh.triangles.Length;
    }

    static int Live(string socket)
    {
        FacetFace face = Begin(socket, Facet.Profile.Displacements);
        UnityEngine.Mesh mesh = face.GetComponent<MeshFilter>().sharedMesh;
        for (int k = 0; k < 10; ++k)
        {
            Vector3[] before = mesh.vertices;
            Until(face, "a face", () => mesh.vertices.Length > 0 && !ReferenceEquals(mesh.vertices, before));
        }
        Console.WriteLine(mesh.vertices.Length + " vertices, " + mesh.triangles.Length / 3 + " triangles, " + face.state);
        Call(face, "OnDisable");
        return 0;
    }
}
