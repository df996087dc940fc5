// As much of UnityEngine as FacetFace.cs uses, so that it compiles and runs without Unity. What Unity refuses of a mesh is an exception here.
using System;
using System.Linq;

namespace UnityEngine
{
    public struct Vector2 { public float x, y; public Vector2(float x, float y) { this.x = x; this.y = y; } }
    public struct Vector3 { public float x, y, z; public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; } }
    public struct Color { public float r, g, b, a; public Color(float r, float g, float b, float a) { this.r = r; this.g = g; this.b = b; this.a = a; } }
    public struct Quaternion
    {
        public Vector3 forward, up;
        public static Quaternion LookRotation(Vector3 forward, Vector3 up) { return new Quaternion { forward = forward, up = up }; }
    }
    public static class Mathf { public static float Clamp01(float value) { return Math.Min(Math.Max(value, 0.0f), 1.0f); } }
    namespace Rendering { public enum IndexFormat { UInt16, UInt32 } }
    public class Object { }
    public class Mesh : Object
    {
        Vector3[] points = new Vector3[0], directions = new Vector3[0];
        Vector2[] coordinates = new Vector2[0];
        Color[] colours = new Color[0];
        int[] corners = new int[0];

        public Rendering.IndexFormat indexFormat { get; set; }
        public Vector3[] vertices
        {
            get { return points; }
            set
            {
                if (corners.Any(corner => corner >= value.Length))
                    throw new ArgumentException("Mesh.vertices is too small: fewer vertices than the triangles name");
                points = value;
            }
        }
        public Vector3[] normals { get { return directions; } set { directions = OnePerVertex(value); } }
        public Vector2[] uv { get { return coordinates; } set { coordinates = OnePerVertex(value); } }
        public Color[] colors { get { return colours; } set { colours = OnePerVertex(value); } }
        public int[] triangles
        {
            get { return corners; }
            set
            {
                if (value.Length % 3 != 0 || value.Any(corner => corner < 0 || corner >= points.Length))
                    throw new ArgumentException("Mesh.triangles names vertices that are not there");
                corners = value;
            }
        }
        public string[] shapes = new string[0];
        public int blendShapeCount { get { return shapes.Length; } }
        public string GetBlendShapeName(int k) { return shapes[k]; }
        public void MarkDynamic() { }
        public void RecalculateBounds() { }
        public void Clear()
        {
            points = directions = new Vector3[0];
            coordinates = new Vector2[0];
            colours = new Color[0];
            corners = new int[0];
        }
        T[] OnePerVertex<T>(T[] values)
        {
            if (values.Length != points.Length)
                throw new ArgumentException("another number of values than of vertices");
            return values;
        }
    }
    public class Transform : Object { public Quaternion localRotation { get; set; } }
    public class MonoBehaviour : Object
    {
        readonly Transform place = new Transform();
        readonly MeshFilter filter = new MeshFilter();
        public Transform transform { get { return place; } }
        public T GetComponent<T>() { return (T)(object)filter; }
    }
    public class MeshFilter : Object { public Mesh sharedMesh { get; set; } }
    public class MeshRenderer : Object { }
    public class SkinnedMeshRenderer : Object
    {
        public Mesh sharedMesh { get; set; }
        public readonly System.Collections.Generic.Dictionary<int, float> weights = new System.Collections.Generic.Dictionary<int, float>();
        public void SetBlendShapeWeight(int shape, float weight) { weights[shape] = weight; }
    }
    public sealed class RequireComponent : Attribute { public RequireComponent(Type a, Type b) { } }
    public sealed class TooltipAttribute : Attribute { public TooltipAttribute(string words) { } }
}
