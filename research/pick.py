import json,sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
D=[json.loads(l) for l in open(sys.argv[1])]
rows=[]
for r in D:
    s=random_scan(r["seed"],r["n"],CACHE); A=s.A; g=A.geometry
    mag=np.linalg.norm(g.source,axis=1).mean()/np.linalg.norm(g.detector-g.source,axis=1).mean()
    q=g.panel.pitch_u*mag
    nv=noise_var(s.p,s.photons); w=1/(nv+np.float32(r["m2"]))
    seen=s.p>0.02*np.percentile(s.p,99)
    wn=float(np.sqrt(np.mean((w*w*nv)[seen]))); 
    en=np.log2(max(np.sqrt(len(A))*wn/q*s.mu/10,1e-9))
    wm=float(np.sqrt(np.mean((w*w)[seen])*r["m2"])); em=np.log2(np.sqrt(len(A))*wm/q*s.mu/10)
    e=np.array([x["e"] for x in r["rows"]],float); le=np.log(np.array([x["err"] for x in r["rows"]])); chi=np.array([x["chi"] for x in r["rows"]])
    rows.append((r,e,le,chi,en,em,len(A)/r["n"]))
def at(e,le,x): # e decreasing
    x=min(max(x,e[-1]-1),e[0]); 
    return np.interp(x,e[::-1],le[::-1])-le.min() + (0.3*max(0,e[-1]-x))
def echi(e,chi,t):
    if (chi>t).all(): return e[-1]-1
    if chi[0]<=t: return e[0]
    k=int(np.argmax(chi<=t)); f=(np.log(chi[k-1])-np.log(t))/(np.log(chi[k-1])-np.log(chi[k])); return e[k-1]-f
for kn in (-.6,-.3,0):
    for t in (.6,.7,.75,.8,.85):
        L=[np.exp(at(e,le,max(en+kn,echi(e,chi,t)))) for r,e,le,chi,en,em,vn in rows]
        print("max: kn %.1f tau %.2f median %.3f p90 %.3f max %.2f"%(kn,t,np.median(L),np.percentile(L,90),max(L)))
for kn,km in ((0,1),(-.3,1),(-.3,1.4)):
    L=[np.exp(at(e,le,.5*np.log2(2**(2*(en+kn))+2**(2*(em+km))*max(1,vn)))) for r,e,le,chi,en,em,vn in rows]
    print("formula",kn,km,"median %.3f p90 %.3f max %.2f"%(np.median(L),np.percentile(L,90),max(L)))
for r,e,le,chi,en,em,vn in rows:
    b=e[le.argmin()]; print(r["seed"],r["family"],"v/n %.1f nv/m2 %.2f"%(vn,r["nv"]/r["m2"]),"best e",b,"en %.1f em %.1f echi.75 %.1f"%(en,em,echi(e,chi,.75)),"chib %.2f"%chi[le.argmin()],"b/sart %.2f"%(np.exp(le.min())/r["sart"][0]))
